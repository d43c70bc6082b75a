"""What a comparison of methods needs of a benchmark: its pairs, its problems, its scores."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

from scenediff_classic.detection_run import CaptureOptions

Evidence = TypeVar("Evidence")
"""What a benchmark keeps of one judged pair; only the benchmark itself looks into it."""


@dataclass(frozen=True)
class BenchmarkPair:
    """Two captures of a place, as every method is given them."""

    name: str
    """Unique within the benchmark, and fit to be the name of a folder."""
    before: CaptureOptions
    after: CaptureOptions
    group: str = ""
    """What the pair is counted under beside the whole: a subset, a hard case, a lighting."""
    truth: Path | None = None
    """What says what changed: a file, or a folder that holds it."""
    known_geometry: Path | None = None
    """True or published cameras (and depth), in a form that ``--geometry`` takes."""


@runtime_checkable
class Benchmark(Protocol[Evidence]):
    """A set of pairs with truth, and how answers to them are scored.

    Judging a pair and pooling what was judged are apart, so that pairs can be drawn again and again
    for confidence intervals without reading any file twice.
    """

    @property
    def name(self) -> str:
        """As tables and configurations call it."""
        ...

    @property
    def metrics(self) -> Mapping[str, str]:
        """Key of each figure, and its heading; figures are from 0 to 1, more is better."""
        ...

    def pairs(self) -> tuple[BenchmarkPair, ...]:
        """All pairs, in the benchmark's order."""
        ...

    def problems(self) -> tuple[str, ...]:
        """Everything that is wrong with the folder, a sentence each; none if it can be used."""
        ...

    def judge(self, pair: BenchmarkPair, run: Path | None) -> Evidence:
        """Score one answer.

        Parameters
        ----------
        run : Path, optional
            Output folder of a method (docs/output.md); None if the method failed there.
        """
        ...

    def pool(self, judged: Sequence[Evidence]) -> dict[str, float | None]:
        """The figures of some judged pairs together, by the keys of `metrics`; None = undefined."""
        ...
