"""Geometric consistency: a depth counts once other views' depths agree with it."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int32

from scenediff_classic.cameras import pixel_centres, project, sample, unproject, world_from_cam
from scenediff_classic.types import View


def count_supporters(
    view: View, others: Sequence[View], *, max_pixels: float, max_relative: float
) -> Int32[np.ndarray, "h w"]:
    """How many other views' own depth agrees with each pixel's depth, forward and backward.

    A pixel's point is carried into the other view, moved along that view's ray to the depth
    found there, and carried back: it must return within `max_pixels` and its depth within the
    fraction `max_relative`.
    """
    height, width = view.shape
    points = unproject(view).astype(np.float64)
    home = pixel_centres(height, width)
    supporters = np.zeros((height, width), np.int32)
    for other in others:
        returned, depth = _there_and_back(points, view, other)
        with np.errstate(invalid="ignore"):
            near = np.sum((returned - home) ** 2, axis=-1) <= max_pixels**2
            supporters += near & (np.abs(depth - view.depth) <= max_relative * view.depth)
    return supporters


def _there_and_back(points: np.ndarray, view: View, other: View) -> tuple[np.ndarray, np.ndarray]:
    """Pixel (h, w, 2) and depth (h, w) in `view` of the surface that `other` sees at `points`."""
    xy, _ = project(points, other.intrinsics, other.cam_from_world)
    depth = sample(other.depth, xy, nearest=True)
    pixels = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1)
    in_cam = pixels @ np.linalg.inv(other.intrinsics).T * depth[..., None]
    to_world = world_from_cam(other.cam_from_world)
    return project(
        in_cam @ to_world[:3, :3].T + to_world[:3, 3], view.intrinsics, view.cam_from_world
    )
