"""How likely a depth is right, told from what confirms it."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int32, Num

RIGHT = 0.02
"""A depth counts as right within this fraction of the truth."""

SMOOTHEST, ROUGHEST = 1e-4, 1e-1
"""Relative bends of the surface below and above which roughness no longer changes."""


@dataclass(frozen=True)
class ConfidenceWeights:
    """Evidence that a depth is right, as the logarithm of its odds (logistic regression).

    A matcher says which are its own: ``python -m tests.benchmarks.stereo_confidence`` fits them.
    """

    constant: float
    per_doubling: float
    """Times log2(1 + supporters)."""
    per_cost: float
    per_roughness: float
    neighbourhood: int = 1
    """Roughness is the mean over a square of so many pixels."""

    def __call__(
        self,
        supporters: Num[np.ndarray, "*shape"],
        cost: Float[np.ndarray, "*shape"],
        rough: Float[np.ndarray, "*shape"],
    ) -> Float[np.ndarray, "*shape"]:
        """Probability that each depth is right (within `RIGHT` of the truth)."""
        evidence = (
            self.constant
            + self.per_doubling * np.log2(1 + supporters)
            + self.per_cost * cost
            + self.per_roughness * rough
        )
        return 1 / (1 + np.exp(-evidence))


PIXEL_BY_PIXEL = ConfidenceWeights(4.30, 1.19, -1.94, -1.40)
"""What is kept and what counts as measured goes by these, for any matcher: they judge every pixel
by itself and are wary. Where right depth ends is blurred by weights that look around a pixel, as
the better calibrated ones of the matchers do; detection got worse by them (`docs/method.md`)."""


def depth_confidence(
    weights: ConfidenceWeights,
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
    probability = weights(supporters, cost, roughness(depth, weights.neighbourhood))
    return np.where(np.isfinite(depth), probability, 0).astype(np.float32)


def roughness(
    depth: Float32[np.ndarray, "h w"], neighbourhood: int = 1
) -> Float32[np.ndarray, "h w"]:
    """Decimal orders of magnitude by which a surface bends more than `SMOOTHEST`.

    The bend is the second difference of inverse depth, which is 0 on any plane, relative to
    inverse depth; the larger one of along the row and along the column; averaged over
    a square of `neighbourhood` pixels.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1 / depth
        bend = np.zeros(depth.shape, np.float32)
        across = np.abs(inverse[:, :-2] + inverse[:, 2:] - 2 * inverse[:, 1:-1])
        down = np.abs(inverse[:-2] + inverse[2:] - 2 * inverse[1:-1])
        bend[:, 1:-1] = across / inverse[:, 1:-1]
        bend[1:-1] = np.fmax(bend[1:-1], down / inverse[1:-1])
    bend = np.nan_to_num(bend, nan=SMOOTHEST)
    decades = np.log10(np.clip(bend, SMOOTHEST, ROUGHEST) / SMOOTHEST)
    return cv2.blur(decades, (neighbourhood, neighbourhood))
