"""Which detection found which truth.

Both matchers take IoU with detections as rows, the most confident first, and truths as columns;
a match needs an IoU strictly above one half. They answer one verdict per detection.
"""

import numpy as np
from jaxtyping import Float, Int8

IOU_THRESHOLD = 0.5

HIT, FALSE, DROPPED = np.int8(1), np.int8(0), np.int8(-1)
"""Verdicts: found a truth; found none; counts neither way (a tolerated duplicate, for one)."""


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


def ignore_partnered(
    verdicts: Int8[np.ndarray, "n"], partner_iou: Float[np.ndarray, "n m"]
) -> Int8[np.ndarray, "n"]:
    """The rule for detections that come in pairs, one in each capture, as those of CYWS-3D do.

    A false detection whose partner in the other capture's view finds a truth there is dropped, not
    false: it marks where that truth's object is missing (the paper's supplement, "Details about
    CYWS-3D").

    Parameters
    ----------
    partner_iou : array (n, m)
        IoU of each detection's partner with each truth; zeros where there is no partner. Whether
        another detection found that truth does not matter.
    """
    right = (partner_iou > IOU_THRESHOLD).any(axis=1)
    return np.where((verdicts == FALSE) & right, DROPPED, verdicts)


def _best(overlaps: Float[np.ndarray, "m"]) -> int | None:
    """Column of the highest IoU above the threshold, the first of equals."""
    if not len(overlaps):
        return None
    best = int(np.argmax(overlaps))
    return best if overlaps[best] > IOU_THRESHOLD else None
