"""All-point average precision, as PASCAL VOC defined it from 2010 on."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64


@dataclass(frozen=True)
class Ranking:
    """Judged detections and how many there were to find."""

    confidence: Float64[np.ndarray, "n"]
    hit: Bool[np.ndarray, "n"]
    """True where the detection found something not found before."""
    positives: int
    """Number of truths to find."""

    @staticmethod
    def pooled(rankings: Iterable["Ranking"]) -> "Ranking":
        """All detections of several rankings, in their order, against all their truths."""
        parts = list(rankings)
        return Ranking(
            np.concatenate([np.zeros(0), *(r.confidence for r in parts)]),
            np.concatenate([np.zeros(0, bool), *(r.hit for r in parts)]),
            sum(r.positives for r in parts),
        )


NO_DETECTIONS = Ranking.pooled([])


def average_precision(ranking: Ranking) -> float:
    """Area under the precision-recall curve; 0 without detections or without truths.

    Detections of equal confidence keep their order.
    """
    if not len(ranking.hit) or not ranking.positives:
        return 0.0
    order = np.argsort(-ranking.confidence, kind="stable")
    found = np.cumsum(ranking.hit[order])
    return precision_recall_area(found / ranking.positives, found / np.arange(1, len(order) + 1))


def precision_recall_area(
    recall: Float[np.ndarray, "n"], precision: Float[np.ndarray, "n"]
) -> float:
    """Sum of recall steps times the best precision at that recall or above."""
    recall = np.concatenate([[0.0], recall, [1.0]])
    precision = np.concatenate([precision, [0.0]])
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.sum(np.diff(recall) * envelope))
