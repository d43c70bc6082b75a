"""Averages of a cell's surroundings, over the picture or over the surface alone."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float32
from scipy.ndimage import distance_transform_edt

from scenediff_classic.features.cells import cell_grid, sampled_at
from scenediff_classic.types import View


def pooled_over_picture(
    channels: Sequence[Float32[np.ndarray, "H W"]], view: View, sigma: float, stride: int
) -> Float32[np.ndarray, "h w c"]:
    """Gaussian averages (`sigma` in working pixels) at the centre of every cell."""
    x, y = cell_grid(view.shape, stride)
    return sampled_at([cv2.GaussianBlur(c, (0, 0), sigma) for c in channels], x, y)


def pooled_over_surface(
    channels: Sequence[Float32[np.ndarray, "H W"]],
    view: View,
    sigma: float,
    stride: int,
    step: float,
) -> Float32[np.ndarray, "h w c"]:
    """The same, but averages stop at depth edges: what lies behind a silhouette stays out.

    A domain transform of log depth (Gastal and Oliveira, SIGGRAPH 2011), on the picture at half
    its size. Unknown depth is taken from the nearest pixel where it is known; a view without any
    depth is pooled over the picture.

    Parameters
    ----------
    step : float
        Relative depth difference that counts like `sigma` pixels of distance.
    """
    unknown = ~np.isfinite(view.depth)
    if unknown.all():
        return pooled_over_picture(channels, view, sigma, stride)
    rows, columns = np.asarray(
        distance_transform_edt(unknown, return_distances=False, return_indices=True)
    )
    guide = np.log(view.depth[rows, columns]).astype(np.float32)
    half = tuple(-(-n // 2) for n in reversed(view.shape))
    guide = cv2.resize(guide, half, interpolation=cv2.INTER_NEAREST)
    pooling = cv2.ximgproc.createDTFilter(
        guide, sigma / 2, step, mode=cv2.ximgproc.DTF_RF, numIters=2
    )
    pooled = [pooling.filter(cv2.resize(c, half, interpolation=cv2.INTER_AREA)) for c in channels]
    x, y = cell_grid(view.shape, stride)
    across, down = half[0] / view.shape[1], half[1] / view.shape[0]
    return sampled_at(pooled, x * across, y * down)
