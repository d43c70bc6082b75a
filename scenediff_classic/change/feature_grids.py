"""Features of all views without holding them: each frame is encoded once and kept on disk."""

import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from scenediff_classic.protocols import FeatureExtractor
from scenediff_classic.types import View


class FeatureGrids:
    """Feature grids by position of the view; read from disk whenever they are asked for.

    A grid takes about eight megabytes, and a pair of long videos has hundreds: only the two under
    comparison are in memory.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._last: dict[int, Float32[np.ndarray, "h w c"]] = {}

    @staticmethod
    @contextmanager
    def of(
        views: Iterable[View],
        features: FeatureExtractor,
        folder: Path | None = None,
        finished: Callable[[int], None] = lambda done: None,
    ) -> Iterator["FeatureGrids"]:
        """Encode every view; the grids are deleted at the end of the block.

        Parameters
        ----------
        views : iterable of View
            May be made one by one.
        folder : Path, optional
            Where the grids lie meanwhile; the system's temporary folder if left out.
        finished : callable
            ``finished(number of views done)``.
        """
        with tempfile.TemporaryDirectory(prefix="features-", dir=folder) as name:
            grids = FeatureGrids(Path(name))
            for k, view in enumerate(views):
                np.save(grids._path(k), features(view).astype(np.float32, copy=False))
                finished(k + 1)
            yield grids

    def __getitem__(self, position: int) -> Float32[np.ndarray, "h w c"]:
        """The grid of a view; the last two that were asked for stay in memory."""
        grid = self._last.pop(position, None)
        if grid is None:
            grid = np.load(self._path(position))
            if len(self._last) > 1:
                del self._last[next(iter(self._last))]
        self._last[position] = grid
        return grid

    def _path(self, position: int) -> Path:
        return self._folder / f"{position}.npy"
