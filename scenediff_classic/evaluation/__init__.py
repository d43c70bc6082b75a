"""Scores of predictions against the truth: px/im IoU, obj/im AP and obj/sc AP.

Two modes: ``strict``, what the paper's text says, with no pair ever dropped; and ``official``,
which repeats the published evaluator, quirks included. ``docs/evaluation.md`` lists where they
differ.
"""

from scenediff_classic.evaluation.average_precision import Ranking, average_precision
from scenediff_classic.evaluation.benchmark import EvaluationResult, PairResult, evaluate
from scenediff_classic.evaluation.metrics import Metrics, PixelCounts
from scenediff_classic.evaluation.pairs import PairScores, score_pair
from scenediff_classic.evaluation.rules import Mode, Rules, rules_of
from scenediff_classic.evaluation.tables import pair_table, summary_table, to_json

__all__ = [
    "EvaluationResult",
    "Metrics",
    "Mode",
    "PairResult",
    "PairScores",
    "PixelCounts",
    "Ranking",
    "Rules",
    "average_precision",
    "evaluate",
    "pair_table",
    "rules_of",
    "score_pair",
    "summary_table",
    "to_json",
]
