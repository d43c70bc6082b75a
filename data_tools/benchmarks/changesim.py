"""ChangeSim, two photos at a time.

Layout: ``Query_Seq_Test/<Warehouse>/<Seq>/`` (also below ``Localization/``) with ``rgb/<n>.png``,
the matched reference picture ``t0/rgb/<n>.png``, and ``change_segmentation/<n>.png`` in colours,
black where nothing changed. Names of sequences may end in ``_dark`` or ``_dust``.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from data_tools.benchmarks.benchmark import BenchmarkPair
from data_tools.benchmarks.folder_checks import picture_files, picture_size
from data_tools.benchmarks.symmetric import symmetric_masks
from data_tools.benchmarks.truth_pictures import count, f1, mean, read_mask_picture
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.metrics import PixelCounts

Condition = Literal["normal", "dark", "dust"]
CONDITIONS: tuple[Condition, ...] = get_args(Condition)
SplitName = Literal["test", "train"]


@dataclass(frozen=True)
class ChangeSimBenchmark:
    """Pairs of a reference and a query picture; symmetric change in the query is asked for."""

    root: Path
    split: SplitName = "test"
    condition: Condition = "normal"
    every: int = 1
    """Take every so many pictures of a sequence."""
    name: str = "changesim"

    @property
    def metrics(self) -> Mapping[str, str]:
        """F1 of changed pixels, pooled over all pictures."""
        return {"f1": "F1"}

    def pairs(self) -> tuple[BenchmarkPair, ...]:
        """By warehouse, sequence, picture; the group is the warehouse."""
        sequences = self._sequences()
        if not sequences:
            raise InputError(self._nothing())
        return tuple(
            BenchmarkPair(
                f"{folder.parent.name}_{folder.name}_{query.stem}",
                CaptureOptions(folder / "t0" / "rgb" / query.name),
                CaptureOptions(query),
                group=folder.parent.name,
                truth=folder / "change_segmentation" / query.name,
            )
            for folder in sequences
            for query in picture_files(folder / "rgb")[:: self.every]
        )

    def problems(self) -> tuple[str, ...]:
        """Everything that is wrong with any sequence."""
        sequences = self._sequences()
        if not sequences:
            return (self._nothing(),)
        return tuple(problem for folder in sequences for problem in _problems(folder))

    def statistics(self) -> Mapping[str, float]:
        """Sequences, pictures, and the mean share of changed pixels."""
        truths = [p.truth for p in self.pairs() if p.truth is not None]
        area = mean(float(read_mask_picture(path, 0).mean()) for path in truths)
        return {
            "sequences": len(self._sequences()),
            "pictures": len(truths),
            "mean changed area": area or 0.0,
        }

    def judge(self, pair: BenchmarkPair, run: Path | None) -> PixelCounts:
        """Pixels of the query picture; see `symmetric_masks`."""
        assert pair.truth is not None
        found = {} if run is None else symmetric_masks(run)[1]
        return count(found.get(0), read_mask_picture(pair.truth, 0))

    def pool(self, judged: Sequence[PixelCounts]) -> dict[str, float | None]:
        """All pixels together."""
        return {"f1": f1(sum(judged, PixelCounts()))}

    def _sequences(self) -> list[Path]:
        folder = f"Query_Seq_{self.split.capitalize()}"
        tops = folder, f"Localization/{folder}"
        found = [path for top in tops for path in self.root.glob(f"{top}/*/*")]
        return sorted(p for p in found if (p / "rgb").is_dir() and _condition(p) == self.condition)

    def _nothing(self) -> str:
        where = f"Query_Seq_{self.split.capitalize()}/<Warehouse>/<Seq>/rgb"
        return f"{self.root} holds no {where} for the condition '{self.condition}'."


def _condition(sequence: Path) -> Condition:
    for condition in CONDITIONS:
        if sequence.name.endswith(f"_{condition}"):
            return condition
    return "normal"


def _problems(folder: Path) -> Iterator[str]:
    queries = picture_files(folder / "rgb")
    if not queries:
        yield f"{folder / 'rgb'} holds no pictures."
    for query in queries:
        size = picture_size(query)
        if size is None:
            yield f"{query} cannot be read as a picture."
        reference = folder / "t0" / "rgb" / query.name
        if picture_size(reference) is None:
            yield f"{reference} is missing or cannot be read as a picture."
        truth = folder / "change_segmentation" / query.name
        if picture_size(truth) is None:
            yield f"{truth} is missing or cannot be read as a picture."
        elif size is not None and picture_size(truth) != size:
            yield f"{truth} has another size than {query}."
