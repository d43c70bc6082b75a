"""Which detection found which truth.

Both matchers take IoU with detections as rows, the most confident first, and truths as columns;
a match needs an IoU strictly above one half. They answer one verdict per detection.
"""

import numpy as np
from jaxtyping import Float, Int8

IOU_THRESHOLD = 0.5

HIT, FALSE, DROPPED = np.int8(1), np.int8(0), np.int8(-1)
"""Verdicts: found a truth; found none; counts neither way (a tolerated duplicate)."""


def match_best(iou: Float[np.ndarray, "n m"], duplicates: int = 1) -> Int8[np.ndarray, "n"]:
    """The published evaluator's rule: every detection goes for its best truth, taken or not.

    Parameters
    ----------
    iou : array (n, m)
        IoU of each detection with each truth.
    duplicates : int
        How many detections a truth may absorb: the first is a hit, further ones up to this
        number are dropped, and those beyond it are false.
    """
    verdicts = np.full(len(iou), FALSE)
    taken = np.zeros(iou.shape[1], int)
    for row, overlaps in enumerate(iou):
        best = _best(overlaps)
        if best is None:
            continue
        if taken[best] == 0:
            verdicts[row] = HIT
        elif taken[best] < duplicates:
            verdicts[row] = DROPPED
        taken[best] += 1
    return verdicts


def match_free(iou: Float[np.ndarray, "n m"]) -> Int8[np.ndarray, "n"]:
    """The paper's rule (Sec. 3): greedy by confidence, each truth found at most once.

    A detection whose best truth is taken may have the best one that is still free.
    """
    verdicts = np.full(len(iou), FALSE)
    free = np.ones(iou.shape[1], bool)
    for row, overlaps in enumerate(iou):
        best = _best(np.where(free, overlaps, 0.0))
        if best is not None:
            verdicts[row] = HIT
            free[best] = False
    return verdicts


def _best(overlaps: Float[np.ndarray, "m"]) -> int | None:
    """Column of the highest IoU above the threshold, the first of equals."""
    if not len(overlaps):
        return None
    best = int(np.argmax(overlaps))
    return best if overlaps[best] > IOU_THRESHOLD else None
