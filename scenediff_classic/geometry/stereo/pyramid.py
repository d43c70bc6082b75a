"""The pictures of each pyramid level, and the planes a level starts from."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float32, Float64
from scipy.spatial import KDTree

from scenediff_classic.cameras import pixel_centres, project, scale_intrinsics
from scenediff_classic.types import View


class Pictures(NamedTuple):
    """A reference picture, its sources, and how to get from one to the others."""

    reference: np.ndarray
    """(h, w) float32, grey in 0..1, NaN = ignored."""
    sources: np.ndarray
    """(s, H, W) float32, each held on past its right and bottom rim by at least one pixel."""
    sizes: np.ndarray
    """(s, 2) int32, height and width of each source."""
    warps: np.ndarray
    """(s, 3, 4) float32, ``[A | b]``."""
    depths: np.ndarray
    """(s, H, W) float32, inverse depth found in each source, 0 = none."""
    returns: np.ndarray
    """(s, 3, 4) float32, the maps from each source back into the view."""
    camera: np.ndarray
    """(4,) float32, fx, fy, cx, cy of the reference."""


def pictures_at(view: View, others: Sequence[View], shrink: int) -> Pictures:
    """Pictures of one pyramid level and the maps between the view and each source.

    Depth of the sources is only carried at full size.
    """
    reference, K_ref = _level(view, shrink)
    levels = [_level(other, shrink) for other in others]
    sizes = np.array([image.shape for image, _ in levels], np.int32)
    room = sizes.max(axis=0) + 1  # bilinear reads one pixel past the last one
    sources = np.empty((len(levels), *room), np.float32)
    warps = np.empty((len(levels), 3, 4), np.float32)
    returns = np.empty_like(warps)
    depths = np.zeros((len(levels), *room) if shrink == 1 else (len(levels), 1, 1), np.float32)
    for i, (other, (image, K_src)) in enumerate(zip(others, levels, strict=True)):
        margins = [(0, room[0] - image.shape[0]), (0, room[1] - image.shape[1])]
        sources[i] = np.pad(image, margins, mode="edge")
        source_from_view = other.cam_from_world @ np.linalg.inv(view.cam_from_world)
        warps[i, :, :3] = K_src @ source_from_view[:3, :3] @ np.linalg.inv(K_ref)
        warps[i, :, 3] = K_src @ source_from_view[:3, 3]
        back = np.linalg.inv(source_from_view)
        returns[i, :, :3] = K_ref @ back[:3, :3] @ np.linalg.inv(K_src)
        returns[i, :, 3] = K_ref @ back[:3, 3]
        if shrink == 1:
            h, w = image.shape
            depths[i, :h, :w] = np.nan_to_num(1 / other.depth, nan=0.0)
    camera = K_ref[[0, 1, 0, 1], [0, 1, 2, 2]].astype(np.float32)
    return Pictures(reference, sources, sizes, warps, depths, returns, camera)


def _level(
    view: View, shrink: int
) -> tuple[Float32[np.ndarray, "h w"], Float64[np.ndarray, "3 3"]]:
    """Grey picture (0 to 1, NaN = ignored) and intrinsics at 1 / `shrink` of the size."""
    grey = cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    height, width = grey.shape
    size = (max(round(width / shrink), 1), max(round(height / shrink), 1))
    if shrink > 1:
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    ignore = cv2.resize(view.ignore.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
    grey[ignore] = np.nan
    return grey, scale_intrinsics(view.intrinsics, size[0] / width, size[1] / height)


def first_planes(
    view: View,
    points: np.ndarray,
    shape: tuple[int, int],
    camera: np.ndarray,
    w_range: tuple[float, float],
    rng: np.random.Generator,
) -> Float32[np.ndarray, "h w 3"]:
    """Starting planes: depth of the nearest sparse point or random; random normals."""
    height, width = shape
    centres = pixel_centres(height, width)
    w = rng.uniform(*w_range, (height, width))
    xy, depth = project(points, view.intrinsics, view.cam_from_world)
    ahead = depth > 0
    if np.any(ahead):
        scale = (width / view.shape[1], height / view.shape[0])
        nearest = KDTree(xy[ahead] * scale).query(centres)[1]
        w = np.clip(1 / depth[ahead][nearest], *w_range)
    ray_x, ray_y = np.moveaxis((centres - camera[2:]) / camera[:2], -1, 0)
    nx, ny = rng.uniform(-0.6, 0.6, (2, height, width))
    towards = nx * ray_x + ny * ray_y + 1.0
    towards = np.where(towards > 0.3, towards, np.inf)  # too edge-on: start parallel to the picture
    planes = np.stack([w, w * nx / (camera[0] * towards), w * ny / (camera[1] * towards)], -1)
    return planes.astype(np.float32)


def upsample_planes(
    planes: Float32[np.ndarray, "h w 3"], shape: tuple[int, int]
) -> Float32[np.ndarray, "H W 3"]:
    """The same planes on a finer grid: each fine pixel extends the plane it lies on."""
    height, width = planes.shape[:2]
    y, x = (np.arange(n) + 0.5 for n in shape)
    y, x = y * (height / shape[0]), x * (width / shape[1])
    rows, cols = y.astype(int), x.astype(int)
    coarse = planes[rows[:, None], cols[None, :]]
    dx, dy = (x - cols - 0.5)[None, :], (y - rows - 0.5)[:, None]
    w = coarse[..., 0] + coarse[..., 1] * dx + coarse[..., 2] * dy
    w = np.where(w > 0, w, coarse[..., 0])
    gx, gy = coarse[..., 1] * (width / shape[1]), coarse[..., 2] * (height / shape[0])
    return np.stack([w, gx, gy], axis=-1).astype(np.float32)
