"""Rendered pairs with exact truth, as a benchmark.

The folders are those that ``python -m data_tools.synthetic_pairs`` makes.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from data_tools.benchmarks.benchmark import BenchmarkPair
from data_tools.benchmarks.folder_checks import Size, mask_problems, picture_sizes
from data_tools.benchmarks.mask_judge import MASK_METRICS, MaskJudge, mask_statistics
from data_tools.benchmarks.rows import rendered_pairs
from scenediff_classic.dataset import records
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.pairs import PairScores
from scenediff_classic.evaluation.rules import Mode
from scenediff_classic.types import VIDEOS, Video

EASY = "none"
"""Group of the pairs that nothing makes hard."""
_GEOMETRY = ("intrinsics", "cam_from_world", "depth", "video", "index")


@dataclass(frozen=True)
class RenderedBenchmark:
    """Rendered pairs below a folder."""

    root: Path
    mode: Mode = "strict"
    name: str = "synthetic"

    @property
    def metrics(self) -> Mapping[str, str]:
        """Those of masks of objects."""
        return MASK_METRICS

    def pairs(self) -> tuple[BenchmarkPair, ...]:
        """By name; the group is what makes a pair hard."""
        return tuple(_pair(folder) for folder in self._folders)

    def problems(self) -> tuple[str, ...]:
        """Everything that is wrong with any of the folders."""
        try:
            folders = self._folders
        except InputError as error:
            return (str(error),)
        return tuple(problem for folder in folders for problem in _problems(folder))

    def statistics(self) -> Mapping[str, float]:
        """Objects by kind, annotated frames, visible area."""
        return mask_statistics([folder / "segments.json" for folder in self._folders])

    def judge(self, pair: BenchmarkPair, run: Path | None) -> PairScores | None:
        """Compare masks; see `MaskJudge.judge`."""
        assert pair.truth is not None
        return MaskJudge(self.mode).judge(pair.truth, run)

    def pool(self, judged: Sequence[PairScores | None]) -> dict[str, float | None]:
        """See `MaskJudge.pool`."""
        return MaskJudge(self.mode).pool(judged)

    @cached_property
    def _folders(self) -> list[Path]:
        return rendered_pairs(self.root)


def _pair(folder: Path) -> BenchmarkPair:
    hard = _hard_cases(folder)
    known = folder / "truth_geometry.npz"
    return BenchmarkPair(
        folder.name,
        CaptureOptions(folder / "before"),
        CaptureOptions(folder / "after"),
        group=", ".join(map(str, hard)) or EASY,
        truth=folder / "segments.json",
        known_geometry=known if known.is_file() else None,
    )


def _hard_cases(folder: Path) -> list[object]:
    path = folder / "metadata.json"
    content = records.mapping(records.read_json(path), str(path))
    return list(records.sequence(content.get("hard") or [], f"{path}: 'hard'"))


def _problems(folder: Path) -> Iterator[str]:
    try:
        _hard_cases(folder)
    except InputError as error:
        yield str(error)
    sizes: dict[Video, Sequence[Size]] = {v: picture_sizes(folder / v) for v in VIDEOS}
    for video, found in sizes.items():
        if not found:
            yield f"{folder / video} holds no picture that can be read."
    yield from mask_problems(folder, sizes)
    yield from _geometry_problems(folder / "truth_geometry.npz", sizes)


def _geometry_problems(path: Path, sizes: Mapping[Video, Sequence[object]]) -> Iterator[str]:
    try:
        with np.load(path) as content:
            absent = [key for key in _GEOMETRY if key not in content.files]
            views = 0 if absent else len(content["cam_from_world"])
    except (OSError, ValueError, EOFError) as error:
        yield f"{path} cannot be read: {error}."
        return
    pictures = sum(map(len, sizes.values()))
    if absent:
        yield f"{path} lacks {', '.join(absent)}."
    elif views != pictures:
        yield f"{path} has {views} cameras for {pictures} pictures."
