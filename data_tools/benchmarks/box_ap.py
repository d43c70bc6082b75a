"""AP of boxes in single pictures, as CYWS-3D counts it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from data_tools.benchmarks.hand_boxes import Box, box_iou
from scenediff_classic.evaluation.average_precision import Ranking

Protocol = Literal["raw", "filtered"]
Convention = Literal["half-open", "wide"]
"""``wide``: truth and answers grow by a pixel on every side, two in width and height."""
LEAST_AREA = 400 / 224**2
"""Smallest box that ``filtered`` keeps, as a share of the picture."""
MOST_OVERLAP = 0.2
"""IoU from which on ``filtered`` drops the less sure of two boxes."""


@dataclass(frozen=True)
class ScoredBox:
    """A reported box of one picture: x, y, width, height in input pixels."""

    box: Box
    confidence: float


def box_ranking_in_picture(
    found: Sequence[ScoredBox],
    truth: Sequence[Box],
    size: tuple[int, int],
    protocol: Protocol = "raw",
    convention: Convention = "half-open",
    least_iou: float = 0.5,
) -> Ranking:
    """The boxes of one picture, the surest first, judged.

    Each box asks only the true box that it overlaps most; of several that ask the same, the surest
    is right, and the others are wrong.

    Parameters
    ----------
    size : (height, width)
        Of the picture.
    """
    boxes = sorted(found, key=lambda b: -b.confidence)
    if protocol == "filtered":
        boxes = _filtered(boxes, size)
    grown = [_grown(box, convention) for box in truth]
    taken: set[int] = set()
    hits = []
    for item in boxes:
        overlap = [box_iou(_grown(item.box, convention), box) for box in grown]
        best = int(np.argmax(overlap)) if overlap else -1
        hit = bool(overlap) and overlap[best] >= least_iou and best not in taken
        if hit:
            taken.add(best)
        hits.append(hit)
    scores = np.array([b.confidence for b in boxes], float)
    return Ranking(scores, np.array(hits, bool), len(truth))


def _filtered(boxes: Sequence[ScoredBox], size: tuple[int, int]) -> list[ScoredBox]:
    least = LEAST_AREA * size[0] * size[1]
    kept: list[ScoredBox] = []
    for item in boxes:
        large = item.box[2] * item.box[3] >= least
        if large and all(box_iou(item.box, other.box) <= MOST_OVERLAP for other in kept):
            kept.append(item)
    return kept


def _grown(box: Box, convention: Convention) -> Box:
    x, y, wide, high = box
    return (x - 1, y - 1, wide + 2, high + 2) if convention == "wide" else box
