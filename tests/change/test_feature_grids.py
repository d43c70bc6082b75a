"""Features are encoded once a frame, and never all in memory."""

from pathlib import Path

import numpy as np

from scenediff_classic.change.feature_grids import FeatureGrids
from tests.plane_scene import BOOK, VASE, scene


class Counting:
    """An extractor that notes which frames it was given."""

    similarity, merge = 0.9, 1.4

    def __init__(self) -> None:
        self.seen: list[tuple[str, int]] = []

    def __call__(self, view) -> np.ndarray:
        self.seen.append(view.key)
        return np.full((2, 3, 4), len(self.seen), np.float32)


def test_every_frame_is_encoded_once_and_found_again(tmp_path: Path) -> None:
    views, extractor, done = scene([VASE], [BOOK]).views, Counting(), []
    with FeatureGrids.of(views, extractor, tmp_path, done.append) as grids:
        for position in (3, 0, 5, 0, 3, 3, 1):
            grid = grids[position]
            assert grid.shape == (2, 3, 4)
            assert (grid == position + 1).all()
            assert len(grids._last) <= 2
        assert any(tmp_path.iterdir())
    assert extractor.seen == [v.key for v in views]
    assert done == list(range(1, len(views) + 1))
    assert not any(tmp_path.iterdir())
