"""Rendered pairs as a benchmark (``python -m data_tools.synthetic_pairs`` makes them)."""

import json
from dataclasses import dataclass
from pathlib import Path

from data_tools.benchmarks.annotated import mask_problems
from data_tools.benchmarks.benchmark import BenchmarkPair
from data_tools.benchmarks.mask_scores import MaskScores
from data_tools.benchmarks.rows import rendered_pairs
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.errors import InputError
from scenediff_classic.types import VIDEOS


@dataclass(frozen=True)
class SyntheticPairs(MaskScores):
    """A folder of rendered pairs, with true cameras, depth and masks."""

    root: Path = Path()
    name: str = "synthetic"

    def pairs(self) -> tuple[BenchmarkPair, ...]:
        """All pairs by name, grouped by what makes them hard."""
        return tuple(
            BenchmarkPair(
                folder.name,
                CaptureOptions(folder / "before"),
                CaptureOptions(folder / "after"),
                _hard_case(folder),
                folder,
                folder / "truth_geometry.npz",
            )
            for folder in rendered_pairs(self.root)
        )

    def problems(self) -> tuple[str, ...]:
        """Everything that is wrong with the folder."""
        try:
            folders = rendered_pairs(self.root)
        except InputError as error:
            return (str(error),)
        found = []
        for folder in folders:
            needed = (*VIDEOS, "truth_geometry.npz")
            found += [f"{folder / name} is missing." for name in needed if not _there(folder, name)]
            try:
                _hard_case(folder)
            except InputError as error:
                found.append(str(error))
            found += mask_problems(folder)
        return tuple(found)


def _there(folder: Path, name: str) -> bool:
    path = folder / name
    return path.is_file() or (path.is_dir() and any(path.iterdir()))


def _hard_case(folder: Path) -> str:
    path = folder / "metadata.json"
    try:
        hard = json.loads(path.read_text(encoding="utf-8")).get("hard", [])
        return ", ".join(hard) or "none"
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path} does not say what makes the pair hard: {error}.") from error
