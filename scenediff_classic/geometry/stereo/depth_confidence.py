"""How likely a depth is right, told from what confirms it."""

import numpy as np
from jaxtyping import Float32, Int32

RIGHT = 0.02
"""A depth counts as right within this fraction of the truth."""

WEIGHTS = (4.30, 1.19, -1.94, -1.40)
"""Logistic regression on the validation pairs against true depth: constant, log2(1 + supporters),
cost, roughness. `docs/method.md` names the command that checks it."""

SMOOTHEST, ROUGHEST = 1e-4, 1e-1
"""Relative bends of the surface below and above which roughness no longer changes."""


def depth_confidence(
    depth: Float32[np.ndarray, "h w"],
    cost: Float32[np.ndarray, "h w"],
    supporters: Int32[np.ndarray, "h w"],
) -> Float32[np.ndarray, "h w"]:
    """Probability that each depth is right, 0 where there is none.

    Parameters
    ----------
    cost : array (h, w)
        0 (looks identical in the sources) to 1 (nothing like it found).
    supporters : int array (h, w)
        Views whose own depth agrees.
    """
    constant, per_supporter, per_cost, per_roughness = WEIGHTS
    evidence = (
        constant
        + per_supporter * np.log2(1 + supporters)
        + per_cost * cost
        + per_roughness * roughness(depth)
    )
    probability = 1 / (1 + np.exp(-evidence))
    return np.where(np.isfinite(depth), probability, 0).astype(np.float32)


def roughness(depth: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """Decimal orders of magnitude by which a surface bends more than `SMOOTHEST`.

    The bend is the second difference of inverse depth, which is 0 on any plane, relative to
    inverse depth; the larger one of along the row and along the column.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / depth
        bend = np.zeros(depth.shape, np.float32)
        across = np.abs(inverse[:, :-2] + inverse[:, 2:] - 2 * inverse[:, 1:-1])
        down = np.abs(inverse[:-2] + inverse[2:] - 2 * inverse[1:-1])
        bend[:, 1:-1] = across / inverse[:, 1:-1]
        bend[1:-1] = np.fmax(bend[1:-1], down / inverse[1:-1])
    bend = np.nan_to_num(bend, nan=SMOOTHEST)
    return np.log10(np.clip(bend, SMOOTHEST, ROUGHEST) / SMOOTHEST)
