"""The matching windows of a reference picture, prepared once for all hypotheses; compiled.

The NumPy twin is in `kernels_reference`. Weights fall off as ``(1 - x / 8)^8``, which is close to
``exp(-x)`` and, unlike a mathematical library's ``exp``, the same wherever it is computed.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32
from numba import njit

from scenediff_classic.geometry.stereo.rows import over_rows

_EIGHT = np.float32(8)


class Windows(NamedTuple):
    """What is known of every pixel's window before any hypothesis is tried."""

    weights: np.ndarray
    """(h, w, samples) float32, bilateral weights, sum 1."""
    weighted: np.ndarray
    """(h, w, samples) float32, weight times grey value minus the window's mean."""
    variance: np.ndarray
    """(h, w) float32, weighted variance; -1 where the pixel itself is ignored."""
    dx: np.ndarray
    """(samples,) float32, columns from the pixel to each sample."""
    dy: np.ndarray


def window(radius: int) -> tuple[Float32[np.ndarray, "n"], Float32[np.ndarray, "n"]]:
    """(dx, dy) of a window's samples: every second pixel of the square, like a checkerboard.

    The pixel itself is left out: it differs from its own grey value by nothing.
    """
    steps = np.arange(-radius, radius + 1)
    dy, dx = (a.ravel().astype(np.float32) for a in np.meshgrid(steps, steps, indexing="ij"))
    odd = (dx + dy) % 2 == 1
    return dx[odd], dy[odd]


def prepare_windows(
    reference: Float32[np.ndarray, "h w"], radius: int, grey_sigma: float
) -> Windows:
    """Windows of all pixels of a picture.

    Parameters
    ----------
    reference : float32 array (h, w)
        Grey in 0..1, NaN = ignored.
    grey_sigma : float
        Grey-value difference that a bilateral weight tolerates; over distance, it is the radius.
    """
    dx, dy = window(radius)
    sharpness, nearness = np.float32(0.5 / grey_sigma**2), np.float32(0.5 / radius**2)
    weights = np.empty((*reference.shape, len(dx)), np.float32)
    windows = Windows(
        weights, np.empty_like(weights), np.empty(reference.shape, np.float32), dx, dy
    )
    over_rows(_prepare_rows, len(reference), reference, windows, sharpness, nearness)
    return windows


@njit(nogil=True, cache=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _prepare_rows(reference, windows, sharpness, nearness, first, last):
    height, width = reference.shape
    weights, weighted, variances, dx, dy = windows
    samples = dx.shape[0]
    for row in range(first, last):
        for col in range(width):
            centre = reference[row, col]
            total, mean, variance = np.float32(0), np.float32(0), np.float32(0)
            for k in range(samples):
                r = min(max(row + int(dy[k]), 0), height - 1)
                c = min(max(col + int(dx[k]), 0), width - 1)
                value = reference[r, c] - centre
                distance = dx[k] * dx[k] + dy[k] * dy[k]
                weight = np.float32(1) - (value * value * sharpness + distance * nearness) / _EIGHT
                weight = max(weight, np.float32(0))
                weight *= weight
                weight *= weight
                weight *= weight
                if value != value:  # ignored
                    weight, value = np.float32(0), np.float32(0)
                weights[row, col, k] = weight
                weighted[row, col, k] = value
                total += weight
                mean += weight * value
            scale = np.float32(1) / total if total > 0 else np.float32(0)
            mean *= scale
            for k in range(samples):
                weights[row, col, k] *= scale
                centred = weighted[row, col, k] - mean
                weighted[row, col, k] = weights[row, col, k] * centred
                variance += weighted[row, col, k] * centred
            variances[row, col] = variance if centre == centre else np.float32(-1)
