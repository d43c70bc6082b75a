"""The inner loops of comparing two views, compiled; their plain twins are in the tests."""

import numba
import numpy as np


@numba.njit(cache=True, parallel=True, nogil=True)
def best_cosine(own, other, x, y, reach):
    """Best cosine between each feature and the other grid's features around its reprojection.

    Parameters
    ----------
    own : float32 array (rows, columns, c)
    other : float32 array (rows2, columns2, c)
    x, y : float32 arrays (rows, columns)
        Continuous position in `other`'s cells (first cell's centre at 0.5); NaN = unknown.
    reach : int
        Shifts of up to this many cells along each axis are tried.

    Returns
    -------
    float32 array (rows, columns); NaN where no shifted position is on the grid. Between cell
    centres features are interpolated bilinearly, and held over the outer half cells.
    """
    rows, columns, channels = own.shape
    rows2, columns2 = other.shape[:2]
    out = np.full((rows, columns), np.nan, np.float32)
    for i in numba.prange(rows):
        for j in range(columns):
            if not (-reach <= x[i, j] < columns2 + reach and -reach <= y[i, j] < rows2 + reach):
                continue  # also where x or y is NaN
            best = np.float32(-2.0)
            for dy in range(-reach, reach + 1):
                for dx in range(-reach, reach + 1):
                    u, v = x[i, j] + dx, y[i, j] + dy
                    if not (0 <= u < columns2 and 0 <= v < rows2):
                        continue
                    u = min(max(u - np.float32(0.5), np.float32(0)), np.float32(columns2 - 1))
                    v = min(max(v - np.float32(0.5), np.float32(0)), np.float32(rows2 - 1))
                    left, top = int(u), int(v)
                    right, bottom = min(left + 1, columns2 - 1), min(top + 1, rows2 - 1)
                    wx, wy = np.float32(u - left), np.float32(v - top)
                    a, b = (1 - wx) * (1 - wy), wx * (1 - wy)
                    c, d = (1 - wx) * wy, wx * wy
                    dot, norm = np.float32(0.0), np.float32(0.0)
                    for k in range(channels):
                        value = (
                            a * other[top, left, k]
                            + b * other[top, right, k]
                            + c * other[bottom, left, k]
                            + d * other[bottom, right, k]
                        )
                        dot += own[i, j, k] * value
                        norm += value * value
                    best = max(best, dot / max(np.sqrt(norm), np.float32(1e-6)))
            if best > -2:
                out[i, j] = best
    return out


@numba.njit(cache=True, parallel=True, nogil=True)
def reproject_pixels(points, fit, projection, rotation_z, depth, target_fit, least_gap):
    """Where pixels of one view land in another, and how the depths compare there (eq. 1).

    Parameters
    ----------
    points : float32 array (h, w, 3)
        World points of the source pixels; NaN = unknown.
    fit, target_fit : int8 arrays (h, w), (h2, w2)
        0 = not comparable, 1 = guessed depth, 2 = measured depth.
    projection : float64 array (3, 4)
        Target pixels from world: intrinsics times the top of cam_from_world.
    rotation_z : float64 array (4,)
        Third row of cam_from_world: gives the z-depth.
    depth : float32 array (h2, w2)
        Target depth; NaN = unknown.
    least_gap : float
        tau_occ: pixels farther behind the target's surface than this are occluded.

    Returns
    -------
    xy : float32 array (h, w, 2), gap : float32 array (h, w), and int8 array (h, w):
        0 = occluded or not comparable, 1 = visible, 2 = visible with both depths measured.
    """
    height, width = points.shape[:2]
    rows, columns = depth.shape
    xy = np.full((height, width, 2), np.nan, np.float32)
    gap = np.full((height, width), np.nan, np.float32)
    state = np.zeros((height, width), np.int8)
    for i in numba.prange(height):
        for j in range(width):
            px, py, pz = points[i, j, 0], points[i, j, 1], points[i, j, 2]
            z = rotation_z[0] * px + rotation_z[1] * py + rotation_z[2] * pz + rotation_z[3]
            if not z > 0:
                continue  # behind the camera, or unknown
            p = projection
            u = (p[0, 0] * px + p[0, 1] * py + p[0, 2] * pz + p[0, 3]) / z
            v = (p[1, 0] * px + p[1, 1] * py + p[1, 2] * pz + p[1, 3]) / z
            xy[i, j, 0], xy[i, j, 1] = u, v
            if not (0 <= u < columns and 0 <= v < rows):
                continue
            # bilinear between pixel centres; next to unknown depth the nearest pixel stands in
            s = min(max(u - 0.5, 0.0), columns - 1.0)
            t = min(max(v - 0.5, 0.0), rows - 1.0)
            left, top = int(s), int(t)
            right, bottom = min(left + 1, columns - 1), min(top + 1, rows - 1)
            wx, wy = s - left, t - top
            seen = (depth[top, left] * (1 - wx) + depth[top, right] * wx) * (1 - wy) + (
                depth[bottom, left] * (1 - wx) + depth[bottom, right] * wx
            ) * wy
            near_row, near_column = min(int(v), rows - 1), min(int(u), columns - 1)
            if np.isnan(seen):
                seen = depth[near_row, near_column]
            if np.isnan(seen):
                continue
            gap[i, j] = seen - z
            both = min(fit[i, j], target_fit[near_row, near_column])
            if both > 0 and seen - z >= least_gap:
                state[i, j] = both
    return xy, gap, state
