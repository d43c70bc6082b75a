"""The SceneDiff Benchmark: pairs of videos with masks of what changed.

Layout as published: ``data/<pair>/original_video1.<ext>``, ``original_video2.<ext>`` and
``segments.pkl`` (or our ``segments.json``), ``splits/{val,test}_split.json``. Annotations count
frames at 30 a second whatever the video's own rate; sampling one frame a second by presentation
time gives frame k the annotation index 30 k.
"""

import json
from dataclasses import dataclass
from pathlib import Path

from data_tools.benchmarks.annotated import mask_problems
from data_tools.benchmarks.benchmark import BenchmarkPair
from data_tools.benchmarks.mask_scores import MaskScores
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.benchmark import SPLITS, SUBSETS, Split, Subset, find_pairs


@dataclass(frozen=True)
class SceneDiffBenchmark(MaskScores):
    """A copy of the benchmark, or a folder of one's own in its layout."""

    root: Path = Path()
    name: str = "scenediff"
    split: Split | None = None
    subset: Subset | None = None

    def pairs(self) -> tuple[BenchmarkPair, ...]:
        """The pairs of the split, each under the subset that lists it.

        Raises
        ------
        InputError
            If there are none, or the input video of one is missing.
        """
        folders, _ = find_pairs(self.root, self.split, self.subset)
        groups = self._subsets()
        return tuple(
            BenchmarkPair(
                folder.name,
                CaptureOptions(_video(folder, 1)),
                CaptureOptions(_video(folder, 2)),
                groups.get(folder.name, ""),
                folder,
            )
            for folder in folders
        )

    def problems(self) -> tuple[str, ...]:
        """Everything that is wrong with the folder."""
        try:
            folders, warnings = find_pairs(self.root, self.split, self.subset)
        except InputError as error:
            return (str(error),)
        found = list(warnings)
        present = {folder.name for folder in folders}
        for pair, subset in self._subsets().items():
            if pair not in present and self.split is None and self.subset in (None, subset):
                found.append(f"{self.root}: the split files list '{pair}', which is not there.")
        for folder in folders:
            for number in (1, 2):
                try:
                    _video(folder, number)
                except InputError as error:
                    found.append(str(error))
            found += mask_problems(folder)
        return tuple(found)

    def _subsets(self) -> dict[str, str]:
        """The subset of every pair that a split file lists."""
        found: dict[str, str] = {}
        for split in SPLITS:
            path = self.root / "splits" / f"{split}_split.json"
            if path.is_file():
                content = json.loads(path.read_text(encoding="utf-8"))  # find_pairs has checked it
                for subset in SUBSETS:
                    found |= dict.fromkeys(content[subset], subset)
        return found


def _video(folder: Path, number: int) -> Path:
    """The input of a capture: a film of any container, or a folder of its frames."""
    found = sorted(p for p in folder.glob(f"original_video{number}*") if not p.name.startswith("."))
    exact = [p for p in found if p.name.partition(".")[0] == f"original_video{number}"]
    if len(exact) != 1:
        what = "is missing" if not exact else "is there more than once"
        raise InputError(f"{folder / f'original_video{number}.mp4'} (of any container) {what}.")
    return exact[0]
