"""Judging answers by masks of objects: what every benchmark with annotated masks shares."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from data_tools.benchmarks.benchmark import BenchmarkPair
from data_tools.benchmarks.row_tables import METRICS, numbers
from scenediff_classic.dataset import Prediction, find_prediction, read_annotations, read_prediction
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.pairs import PairScores, score_pair, summarise
from scenediff_classic.evaluation.rules import Mode, rules_of

Judged = PairScores | None
"""None = left out, as official mode does with a pair without a usable answer or truth."""


@dataclass(frozen=True)
class MaskScores:
    """The metrics of the paper (see `scenediff_classic.evaluation`)."""

    mode: Mode = "strict"

    @property
    def metrics(self) -> Mapping[str, str]:
        """Key of each figure, and its heading."""
        return METRICS

    def judge(self, pair: BenchmarkPair, run: Path | None) -> Judged:
        """Compare an answer with the masks in the pair's truth.

        Raises
        ------
        InputError
            In strict mode, if the truth cannot be read.
        """
        rules = rules_of(self.mode)
        if pair.truth is None:
            raise InputError(f"The pair {pair.name} has no truth to compare with.")
        try:
            truth = read_annotations(pair.truth)
            prediction = _prediction(run)
        except InputError:
            if not rules.counts_missing:
                return None
            truth, prediction = read_annotations(pair.truth), Prediction(())
        return score_pair(truth, prediction, rules)

    def pool(self, judged: Sequence[Judged]) -> dict[str, float | None]:
        """The figures of some pairs together: detections and pixels are pooled."""
        counted = [scores for scores in judged if scores is not None]
        return numbers(summarise(counted, rules_of(self.mode)))


def _prediction(run: Path | None) -> Prediction:
    path = None if run is None else find_prediction(run)
    if path is None:
        raise InputError(f"{run} holds neither changes.json nor object_masks.pkl.")
    return read_prediction(path)
