"""AP at one IoU, as VOC counts from 2010 on, over the boxes of all pictures together."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from baselines.cyws.boxes import Boxes, iou


def hits(found: Boxes, truth: Float[np.ndarray, "n 4"], at: float = 0.5) -> Bool[np.ndarray, "m"]:
    """Which boxes of a picture are right, best first.

    Each box asks only the truth that it overlaps most; of several that ask the same, the best is
    right, and the others are not.
    """
    right = np.zeros(len(found.score), bool)
    if not len(truth):
        return right
    overlap = iou(found.xyxy, truth)
    taken: set[int] = set()
    for k in np.argsort(-found.score, kind="stable"):
        best = int(overlap[k].argmax())
        if overlap[k, best] >= at and best not in taken:
            taken.add(best)
            right[k] = True
    return right


def average_precision(
    score: Sequence[Float[np.ndarray, "_"]], right: Sequence[Bool[np.ndarray, "_"]], total: int
) -> float:
    """Area under the precision-recall curve at all its points; NaN without any truth.

    Parameters
    ----------
    score, right : sequence of arrays
        Of the boxes of each picture. The order of the pictures does not matter: equal scores are
        one point of the curve.
    total : int
        True boxes in all pictures.
    """
    if total == 0:
        return float("nan")
    scores = np.concatenate([np.zeros(0), *score])
    flags = np.concatenate([np.zeros(0, bool), *right])
    order = np.argsort(-scores, kind="stable")
    scores, flags = scores[order], flags[order]
    ends = np.flatnonzero(np.append(scores[1:] != scores[:-1], True)) if len(scores) else []
    correct = np.cumsum(flags)[ends]
    precision = correct / (np.asarray(ends) + 1)
    recall = np.concatenate([[0.0], correct / total])
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.sum(np.diff(recall) * envelope))
