"""The SceneDiff Benchmark in its published layout.

Inputs are ``data/<pair>/original_video1.<ext>`` and ``original_video2.<ext>`` (not ``video1`` and
``video2``, into which the annotation is painted); one frame a second is taken by presentation
time, so that sampled frame k is annotation index 30 k at any frame rate.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from data_tools.benchmarks.benchmark import BenchmarkPair
from data_tools.benchmarks.folder_checks import Size, mask_problems
from data_tools.benchmarks.mask_judge import MASK_METRICS, MaskJudge, mask_statistics
from scenediff_classic.clips import VIDEO_SUFFIXES, Sampling, read_clip
from scenediff_classic.dataset import annotation_files, records
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.benchmark import SPLITS, SUBSETS, Split, Subset, find_pairs
from scenediff_classic.evaluation.pairs import PairScores
from scenediff_classic.evaluation.rules import Mode
from scenediff_classic.types import VIDEOS, Video

STEMS: dict[Video, str] = {"before": "original_video1", "after": "original_video2"}


@dataclass(frozen=True)
class SceneDiffBenchmark:
    """The benchmark's pairs, or those of a split and a subset."""

    root: Path
    mode: Mode = "strict"
    split: Split | None = None
    subset: Subset | None = None
    name: str = "scenediff"

    @property
    def metrics(self) -> Mapping[str, str]:
        """Those of masks of objects."""
        return MASK_METRICS

    def pairs(self) -> tuple[BenchmarkPair, ...]:
        """In the order of the split files; the group is the subset, varied or kitchen."""
        return tuple(
            BenchmarkPair(
                folder.name,
                CaptureOptions(input_video(folder, "before")),
                CaptureOptions(input_video(folder, "after")),
                group=self._subsets.get(folder.name, ""),
                truth=next(f for f in annotation_files(folder) if f.is_file()),
            )
            for folder in self._folders
        )

    def problems(self) -> tuple[str, ...]:
        """Everything that is wrong with the split files and with any of the pairs."""
        found = list(self._split_problems())
        try:
            folders = self._folders
        except InputError as error:
            return (*found, str(error))
        return (*found, *(problem for folder in folders for problem in _problems(folder)))

    def statistics(self) -> Mapping[str, float]:
        """Objects by kind, annotated frames, visible area."""
        return mask_statistics([p.truth for p in self.pairs() if p.truth is not None])

    def judge(self, pair: BenchmarkPair, run: Path | None) -> PairScores | None:
        """Compare masks; see `MaskJudge.judge`."""
        assert pair.truth is not None
        return MaskJudge(self.mode).judge(pair.truth, run)

    def pool(self, judged: Sequence[PairScores | None]) -> dict[str, float | None]:
        """See `MaskJudge.pool`."""
        return MaskJudge(self.mode).pool(judged)

    @cached_property
    def _folders(self) -> tuple[Path, ...]:
        return find_pairs(self.root, self.split, self.subset)[0]

    @cached_property
    def _subsets(self) -> dict[str, Subset]:
        return {name: subset for _, subset, name in self._listed()}

    def _listed(self) -> Iterator[tuple[Split, Subset, str]]:
        """(split, subset, pair) of every split file that is there and lists something."""
        for split in SPLITS:
            path = _split_file(self.root, split)
            if path.is_file():
                for subset in SUBSETS:
                    for name in names_in_split(path, subset):
                        yield split, subset, name

    def _split_problems(self) -> Iterator[str]:
        try:
            listed = list(self._listed())
        except InputError as error:
            yield str(error)
            return
        if not listed:
            yield f"{self.root / 'splits'} lists no pair: its two split files are missing or empty."
        seen: set[str] = set()
        data = self.root / "data" if (self.root / "data").is_dir() else self.root
        for split, subset, name in listed:
            where = f"{_split_file(self.root, split)} lists '{name}' under {subset}"
            if name in seen:
                yield f"{where}, which is listed before."
            seen.add(name)
            if not (data / name).is_dir():
                yield f"{where}, but {data / name} is absent."
            elif not any(f.is_file() for f in annotation_files(data / name)):
                yield f"{where}, but {data / name} holds no segments.json or segments.pkl."


def input_video(folder: Path, video: Video) -> Path:
    """The input of a capture, whatever its container; a name that does not exist if there is none.

    A method that is given the latter says what is missing, and the pair counts as failed.
    """
    return next(iter(input_videos(folder, video)), folder / f"{STEMS[video]}.mp4")


def input_videos(folder: Path, video: Video) -> list[Path]:
    """All files that could be the input of a capture; there should be one."""
    found = folder.glob(f"{STEMS[video]}.*")
    return sorted(p for p in found if p.suffix.lower() in VIDEO_SUFFIXES)


def names_in_split(path: Path, subset: Subset) -> list[str]:
    """Pairs that a split file lists for a subset.

    Raises
    ------
    InputError
        The file is not in the published layout.
    """
    content = records.mapping(records.read_json(path), str(path))
    names = records.sequence(records.entry(content, subset, str(path)), f"{path}: '{subset}'")
    return [records.text(name, f"{path}: a name in '{subset}'") for name in names]


def _split_file(root: Path, split: Split) -> Path:
    return root / "splits" / f"{split}_split.json"


def _problems(folder: Path) -> Iterator[str]:
    sizes: dict[Video, list[Size]] = {}
    for video in VIDEOS:
        files = input_videos(folder, video)
        if not files:
            yield f"{folder} holds no {STEMS[video]}.mp4 (or .MOV, …), the input of {video}."
        elif len(files) > 1:
            yield f"{folder} holds {len(files)} files {STEMS[video]}.*: keep one."
        for file in files[:1]:
            try:
                sizes[video] = [_first_size(file)]
            except InputError as error:
                yield str(error)
    yield from mask_problems(folder, sizes, whole=False)


def _first_size(path: Path) -> Size:
    """Upright size of a video's first frame; the rest is not decoded."""
    first = Sampling(1.0, 0.0, 1e-3)
    pictures = read_clip(path, first, 4096, lambda text: None, lambda done, total: None)
    for picture in pictures:
        return picture.height, picture.width
    raise InputError(f"{path} has no picture.")
