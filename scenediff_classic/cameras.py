"""Projective geometry: the one place where pixels and metres meet.

All pixel coordinates are continuous; the centre of pixel (column c, row r) is (c + 0.5, r + 0.5).
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Float64

from scenediff_classic.types import Lens, View

_UNDISTORT_STEPS = 12


def pixel_centres(height: int, width: int) -> Float64[np.ndarray, "h w 2"]:
    """Continuous (x, y) of every pixel centre."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack([x, y], axis=-1)


def scale_intrinsics(
    intrinsics: Float64[np.ndarray, "3 3"], scale_x: float, scale_y: float
) -> Float64[np.ndarray, "3 3"]:
    """Intrinsics of the same picture after a resize by the given factors."""
    return np.diag([scale_x, scale_y, 1.0]) @ intrinsics


def world_from_cam(cam_from_world: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "4 4"]:
    """Inverse of a rigid transform."""
    inverse = np.eye(4)
    inverse[:3, :3] = cam_from_world[:3, :3].T
    inverse[:3, 3] = -cam_from_world[:3, :3].T @ cam_from_world[:3, 3]
    return inverse


def camera_centre(cam_from_world: Float64[np.ndarray, "4 4"]) -> Float64[np.ndarray, "3"]:
    """Position of the camera in the world."""
    return -cam_from_world[:3, :3].T @ cam_from_world[:3, 3]


def unproject(view: View) -> Float32[np.ndarray, "h w 3"]:
    """World point of every pixel; NaN where depth is unknown."""
    height, width = view.shape
    rays = pixel_centres(height, width)
    fx, fy = view.intrinsics[0, 0], view.intrinsics[1, 1]
    cx, cy = view.intrinsics[0, 2], view.intrinsics[1, 2]
    skew = view.intrinsics[0, 1]
    y = (rays[..., 1] - cy) / fy
    x = (rays[..., 0] - cx - skew * y) / fx
    in_cam = np.stack([x, y, np.ones_like(x)], axis=-1) * view.depth[..., None]
    to_world = world_from_cam(view.cam_from_world)
    return (in_cam @ to_world[:3, :3].T + to_world[:3, 3]).astype(np.float32)


def project(
    points: Float[np.ndarray, "*n 3"],
    intrinsics: Float64[np.ndarray, "3 3"],
    cam_from_world: Float64[np.ndarray, "4 4"],
) -> tuple[Float64[np.ndarray, "*n 2"], Float64[np.ndarray, "*n"]]:
    """Continuous pixel (x, y) and z-depth of world points.

    Points on or behind the camera plane get NaN pixels; their depth is kept (z <= 0).
    """
    in_cam = points @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    z = in_cam[..., 2]
    safe = np.where(z > 0, z, np.nan)
    xy = (in_cam @ intrinsics.T)[..., :2] / safe[..., None]
    return xy, z


def inside(xy: Float[np.ndarray, "*n 2"], height: int, width: int) -> Bool[np.ndarray, "*n"]:
    """True where a continuous pixel position lies on the picture; NaN is outside."""
    x, y = xy[..., 0], xy[..., 1]
    return (x >= 0) & (x < width) & (y >= 0) & (y < height)


def sample(
    image: Float32[np.ndarray, "h w *c"],
    xy: Float[np.ndarray, "n m 2"],
    *,
    nearest: bool = False,
) -> Float32[np.ndarray, "n m *c"]:
    """Values of `image` at continuous positions; NaN outside.

    Bilinear between pixel centres (edge pixels are held over their outer half), or nearest.
    """
    height, width = image.shape[:2]
    valid = inside(xy, height, width)
    shifted = (np.where(valid[..., None], xy, 0.5) - 0.5).astype(np.float32)
    if nearest:
        column = np.clip(np.floor(shifted[..., 0] + 0.5).astype(int), 0, width - 1)
        row = np.clip(np.floor(shifted[..., 1] + 0.5).astype(int), 0, height - 1)
        out = image[row, column].astype(np.float32)
    else:
        x = np.clip(shifted[..., 0], 0, width - 1)
        y = np.clip(shifted[..., 1], 0, height - 1)
        left = np.minimum(np.floor(x).astype(int), max(width - 2, 0))
        top = np.minimum(np.floor(y).astype(int), max(height - 2, 0))
        right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
        extra = (...,) + (None,) * (image.ndim - 2)
        wx, wy = (x - left)[extra], (y - top)[extra]
        upper = image[top, left] * (1 - wx) + image[top, right] * wx
        lower = image[bottom, left] * (1 - wx) + image[bottom, right] * wx
        out = (upper * (1 - wy) + lower * wy).astype(np.float32)
    out[~valid] = np.nan
    return out


def undistort(
    image: np.ndarray, lens: Lens, intrinsics: Float64[np.ndarray, "3 3"], height: int, width: int
) -> tuple[np.ndarray, Bool[np.ndarray, "h w"]]:
    """Pinhole picture of the given intrinsics and size, and which pixels lie outside the input.

    Parameters
    ----------
    image : array (h_in, w_in, ...)
        The input picture or a smaller copy of it (`lens` describes the full-size input).
    """
    xy = source_from_view(pixel_centres(height, width), lens, intrinsics)
    outside = ~inside(xy, lens.height, lens.width)
    scale = np.array([image.shape[1] / lens.width, image.shape[0] / lens.height])
    shrink = max(image.shape[1] / width, 1.0)
    if shrink > 1.0:  # average before point sampling, or a smaller view would alias
        smaller = (max(round(image.shape[1] / shrink), 1), max(round(image.shape[0] / shrink), 1))
        image = cv2.resize(image, smaller, interpolation=cv2.INTER_AREA)
        scale = np.array([image.shape[1] / lens.width, image.shape[0] / lens.height])
    maps = (xy * scale - 0.5).astype(np.float32)
    out = cv2.remap(
        image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return out, outside


def source_from_view(
    xy: Float[np.ndarray, "*n 2"], lens: Lens, intrinsics: Float64[np.ndarray, "3 3"]
) -> Float64[np.ndarray, "*n 2"]:
    """Input-picture position of undistorted positions (applies the lens distortion)."""
    flat = xy.reshape(-1, 2)
    rays = np.linalg.solve(intrinsics, np.c_[flat, np.ones(len(flat))].T).T
    x, y = rays[:, 0], rays[:, 1]
    k1, k2, p1, p2 = lens.distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * k2)
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    out = (np.c_[xd, yd, np.ones_like(xd)] @ lens.intrinsics.T)[:, :2]
    return out.reshape(xy.shape)


def view_from_source(
    xy: Float[np.ndarray, "*n 2"], lens: Lens, intrinsics: Float64[np.ndarray, "3 3"]
) -> Float64[np.ndarray, "*n 2"]:
    """Undistorted position of input-picture positions; NaN where the lens model has no inverse."""
    flat = xy.reshape(-1, 2)
    rays = np.linalg.solve(lens.intrinsics, np.c_[flat, np.ones(len(flat))].T).T
    xd, yd = rays[:, 0], rays[:, 1]
    k1, k2, p1, p2 = lens.distortion
    x, y = xd, yd
    for _ in range(_UNDISTORT_STEPS):  # Newton's method on `source_from_view`'s polynomial
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * k2)
        slope = k1 + 2 * k2 * r2
        off_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) - xd
        off_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y - yd
        xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        # beyond the polynomial's turning point there is no inverse: small steps stay finite
        determinant = np.maximum(xx * yy - cross * cross, 0.05)
        x, y = (
            x - (yy * off_x - cross * off_y) / determinant,
            y - (xx * off_y - cross * off_x) / determinant,
        )
    back = source_from_view(np.c_[x, y], lens, np.eye(3))
    solved = np.abs(back - flat).max(axis=1) < 0.01
    out = (np.c_[x, y, np.ones_like(x)] @ intrinsics.T)[:, :2]
    out[~solved] = np.nan
    return out.reshape(xy.shape)


def mask_to_source(
    mask: Bool[np.ndarray, "h w"], lens: Lens, intrinsics: Float64[np.ndarray, "3 3"]
) -> Bool[np.ndarray, "h_in w_in"]:
    """Carry a mask of the undistorted working picture to the input picture.

    Interpolated and cut at one half, so that outlines stay smooth when the input is larger.
    """
    if not np.any(lens.distortion):
        h, w = mask.shape
        scale = np.diag([lens.width / w, lens.height / h, 1.0])
        if np.allclose(scale @ intrinsics, lens.intrinsics, rtol=1e-9, atol=1e-6):
            size = (lens.width, lens.height)
            return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5
    out = np.zeros((lens.height, lens.width), bool)
    window = _window(mask, lens, intrinsics)
    centres = pixel_centres(lens.height, lens.width)[window]
    if not centres.size:
        return out
    xy = view_from_source(centres, lens, intrinsics) - 0.5
    maps = np.nan_to_num(xy, nan=-1e4).astype(np.float32)
    soft = cv2.remap(
        mask.astype(np.float32),
        maps[..., 0],
        maps[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=0,
    )
    out[window] = soft > 0.5
    return out


def _window(
    mask: Bool[np.ndarray, "h w"], lens: Lens, intrinsics: Float64[np.ndarray, "3 3"]
) -> tuple[slice, slice]:
    """Rows and columns of the input picture in which the mask lies, a little generous.

    The lens maps the box's inside into the image of its border, so the border is enough.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    y = np.arange(rows[0] - 1, rows[-1] + 3, dtype=float)
    x = np.arange(columns[0] - 1, columns[-1] + 3, dtype=float)
    border = np.concatenate(
        [np.c_[np.full_like(y, end), y] for end in (x[0], x[-1])]
        + [np.c_[x, np.full_like(x, end)] for end in (y[0], y[-1])]
    )
    there = source_from_view(border, lens, intrinsics)
    (left, top), (right, bottom) = there.min(axis=0), there.max(axis=0)
    return (
        slice(max(int(top) - 1, 0), min(max(int(bottom) + 2, 0), lens.height)),
        slice(max(int(left) - 1, 0), min(max(int(right) + 2, 0), lens.width)),
    )
