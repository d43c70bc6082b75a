"""Splats to pixels and back, tile by tile; `rasterizer_reference` holds the readable twin.

A tile of 16 x 16 pixels is composed front to back, Gaussian by Gaussian, row by row: the sixteen
pixels of a row need no branch, so the compiler makes vector instructions of them. Tiles share no
memory, and the gradients of a Gaussian are added up over its tiles in a fixed order afterwards: the
result does not depend on the number of threads.

See `projection_kernels` for the columns of a splat and for why every literal has the arrays' type.
"""

import math
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import overload

TILE = 16
PIXELS = TILE * TILE
OPAQUE = 1e-4
"""Pixels through which less than this share of the light passes are finished."""
MAX_ALPHA = 0.99
MOMENTS = 6
FIXED = 4
"""Channels of every pass: red, green, blue, depth."""

# columns of a splat, as in `projection_kernels` (numba's cache would miss a change there)
_X, _Y, _A, _B, _C, _OPACITY, _CUT, _HALF_WIDTH, _HALF_HEIGHT = range(9)
_CHECK = 8  # Gaussians between two looks at whether a tile is finished

_FLAGS: dict[str, Any] = {
    "cache": True, "error_model": "numpy", "fastmath": {"reassoc", "contract", "arcp", "nsz"},
}  # fmt: skip
_INLINE: dict[str, Any] = {**_FLAGS, "forceinline": True}
_THREAD: dict[str, Any] = {**_FLAGS, "nogil": True}


def _exp(x: float) -> float:
    """Exponential for -5.6 <= x <= 0; the rest only has to stay finite or infinite."""
    return math.exp(x)


@overload(_exp)
def _exp_of_type(x):  # numba compares signatures, annotations included
    if x != types.float32:
        return lambda x: math.exp(x)
    f = np.float32
    eighth, shift, back = f(0.125), f(0.35), f(math.exp(-0.35))
    c2, c3, c4, c5, c6, c7 = (f(1 / math.factorial(k)) for k in range(2, 8))
    one = f(1)

    def impl(x):  # exp(x / 8) by its series about the middle of the range, then ^ 8
        u = eighth * x + shift
        q = c6 + u * c7
        q = c5 + u * q
        q = c4 + u * q
        q = c3 + u * q
        q = c2 + u * q
        q = one + u * q
        q = (one + u * q) * back
        q = q * q
        q = q * q
        return q * q

    return impl


@njit(**_INLINE)
def _span(splat, row, r):
    """Leftmost and rightmost position of a splat within a row of tiles."""
    top = r(row * TILE) - splat[_Y]
    bottom = top + r(TILE)
    # where the ellipse reaches farthest right, relative to its centre; farthest left: opposite
    turn = -splat[_B] / splat[_C] * splat[_HALF_WIDTH]
    right = min(max(turn, top), bottom)
    left = min(max(-turn, top), bottom)
    a, b = splat[_A], splat[_B]
    det = a * splat[_C] - b * b
    reach = -r(2) * splat[_CUT] * a
    slack = r(0.02)
    high = (math.sqrt(max(reach - det * right * right, r(0))) - b * right) / a + slack
    low = (-math.sqrt(max(reach - det * left * left, r(0))) - b * left) / a - slack
    return splat[_X] + low, splat[_X] + high


@njit(**_THREAD)
def list_tiles(splats, order, shape, counts, starts, slot_starts, gaussian, slots, fill):
    """List the splats that touch each tile, front to back; both passes of a counting sort.

    Parameters
    ----------
    order : integer array
        The splats in sight, by depth.
    counts : int32 array (tiles,)
        Scratch.
    starts : int32 array (tiles + 1,)
        Filled on the first pass: where the entries of each tile begin.
    slot_starts : int32 array (n + 1,)
        Likewise: where the slots of each Gaussian begin.
    gaussian, slots : int32 arrays (entries,)
        Filled on the second pass: the Gaussian of each entry; the entries of each Gaussian.
    fill : bool
        Whether this is the second pass.
    """
    r = splats.dtype.type
    across, down = (shape[1] + TILE - 1) // TILE, (shape[0] + TILE - 1) // TILE
    if fill:
        for t in range(across * down):
            counts[t] = starts[t]
    else:
        counts[:] = 0
        slot_starts[:] = 0
    for i in order:
        splat = splats[i]
        top = max(math.floor((splat[_Y] - splat[_HALF_HEIGHT]) / r(TILE)), 0)
        bottom = min(math.floor((splat[_Y] + splat[_HALF_HEIGHT]) / r(TILE)), down - 1)
        slot = slot_starts[i]
        for row in range(top, bottom + 1):
            low, high = _span(splat, row, r)
            left = max(math.floor(low / r(TILE)), 0)
            right = min(math.floor(high / r(TILE)), across - 1)
            for col in range(left, right + 1):
                tile = row * across + col
                if fill:
                    gaussian[counts[tile]] = i
                    slots[slot] = counts[tile]
                slot += 1
                counts[tile] += 1
        if not fill:
            slot_starts[i + 1] = slot - slot_starts[i]
    if not fill:
        starts[0] = 0
        for t in range(across * down):
            starts[t + 1] = starts[t] + counts[t]
        for i in range(len(slot_starts) - 1):
            slot_starts[i + 1] += slot_starts[i]


@njit(**_INLINE)
def _rows(splat, x, y, r):
    """What all pixels of a splat in a tile at (x, y) share: its centre there, and its rows."""
    mx, my = splat[_X] - r(x) - r(0.5), splat[_Y] - r(y) - r(0.5)
    # as int32: from wider numbers the compiler cannot tell that no index overflows, and gives up
    # on vector instructions, which are five times faster
    first = max(np.int32(math.ceil(my - splat[_HALF_HEIGHT])), np.int32(0))
    last = min(np.int32(math.floor(my + splat[_HALF_HEIGHT])), np.int32(TILE - 1))
    return mx, my, r(0.5) * splat[_A], splat[_B], r(0.5) * splat[_C], first, last


@njit(**_INLINE)
def _finished(light, r):
    """Whether no pixel of a tile lets light through any more."""
    most = r(0)
    for i in range(PIXELS):
        most = max(most, light[i])
    return most < r(OPAQUE)


@njit(**_THREAD)
def composite(splats, values, starts, gaussian, planes, first, last):
    """Fill the tiles `first` to `last` of `planes` (channels + 1, h, w); the last one is alpha.

    Parameters
    ----------
    values : array (n, channels)
        What each Gaussian carries: red, green, blue, depth, any others.
    """
    r = splats.dtype.type
    channels, height, width = planes.shape[0] - 1, planes.shape[1], planes.shape[2]
    across = (width + TILE - 1) // TILE
    # light that still passes, weights of one Gaussian, the channels
    s = np.empty((2 + channels) * PIXELS, splats.dtype)
    for t in range(first, last):
        x, y = t % across * TILE, t // across * TILE
        s[:PIXELS] = r(1)
        s[PIXELS:] = r(0)
        for k in range(starts[t], starts[t + 1]):
            i = gaussian[k]
            mx, my, a, b, c, top, bottom = _rows(splats[i], x, y, r)
            opacity, cut = splats[i, _OPACITY], splats[i, _CUT]
            v0, v1, v2, v3 = values[i, 0], values[i, 1], values[i, 2], values[i, 3]
            for row in range(top, bottom + 1):
                dy = r(row) - my
                b_row, c_row = b * dy, c * dy * dy
                base = row * TILE
                for col in range(TILE):
                    at = base + col
                    dx = r(col) - mx
                    power = -(a * dx + b_row) * dx - c_row
                    alpha = min(opacity * _exp(power), r(MAX_ALPHA))
                    alpha = alpha if power >= cut else r(0)
                    light = s[at]
                    alpha = alpha if light >= r(OPAQUE) else r(0)
                    w = alpha * light
                    s[at] = light - w
                    s[at + PIXELS] = w
                    s[at + 2 * PIXELS] += w * v0
                    s[at + 3 * PIXELS] += w * v1
                    s[at + 4 * PIXELS] += w * v2
                    s[at + 5 * PIXELS] += w * v3
                for channel in range(FIXED, channels):
                    plane, value = (2 + channel) * PIXELS + base, values[i, channel]
                    for col in range(TILE):
                        s[plane + col] += s[PIXELS + base + col] * value
            if (k - starts[t]) % _CHECK == 0 and _finished(s, r):
                break
        for row in range(min(TILE, height - y)):
            for col in range(min(TILE, width - x)):
                for channel in range(channels):
                    planes[channel, y + row, x + col] = s[(2 + channel) * PIXELS + row * TILE + col]
                planes[channels, y + row, x + col] = r(1) - s[row * TILE + col]


@njit(**_THREAD)
def composite_backward(
    splats, values, starts, gaussian, planes, d_planes, entry_grads, first, last
):
    """Fill the rows of `entry_grads` (entries, MOMENTS + channels) of tiles `first` to `last`.

    Front to back again, with the same light: the colour behind a Gaussian is what is left of the
    pixel's whole colour, which `planes` holds.
    """
    r = splats.dtype.type
    channels, height, width = planes.shape[0] - 1, planes.shape[1], planes.shape[2]
    across = (width + TILE - 1) // TILE
    # light that passes; gradient-weighted colour behind; weights of one Gaussian; its extras times
    # their gradients; gradients of alpha and of the channels
    s = np.empty((5 + channels) * PIXELS, splats.dtype)
    # for each column: three moments, the gradients of the channels
    sums = np.empty((3 + channels) * TILE, splats.dtype)
    for t in range(first, last):
        x, y = t % across * TILE, t // across * TILE
        s[:PIXELS] = r(1)
        s[PIXELS:] = r(0)
        for row in range(min(TILE, height - y)):
            for col in range(min(TILE, width - x)):
                at = row * TILE + col
                behind = d_planes[channels, y + row, x + col] * planes[channels, y + row, x + col]
                s[4 * PIXELS + at] = d_planes[channels, y + row, x + col]
                for channel in range(channels):
                    g = d_planes[channel, y + row, x + col]
                    s[(5 + channel) * PIXELS + at] = g
                    behind += g * planes[channel, y + row, x + col]
                s[PIXELS + at] = behind
        done = starts[t + 1]
        for k in range(starts[t], starts[t + 1]):
            i = gaussian[k]
            mx, my, a, b, c, top, bottom = _rows(splats[i], x, y, r)
            opacity, cut = splats[i, _OPACITY], splats[i, _CUT]
            v0, v1, v2, v3 = values[i, 0], values[i, 1], values[i, 2], values[i, 3]
            sums[:] = r(0)
            for row in range(top, bottom + 1):
                dy = r(row) - my
                b_row, c_row = b * dy, c * dy * dy
                base = row * TILE
                if channels > FIXED:
                    for col in range(TILE):
                        s[3 * PIXELS + base + col] = r(0)
                for channel in range(FIXED, channels):
                    plane, value = (5 + channel) * PIXELS + base, values[i, channel]
                    for col in range(TILE):
                        s[3 * PIXELS + base + col] += s[plane + col] * value
                for col in range(TILE):
                    at = base + col
                    dx = r(col) - mx
                    power = -(a * dx + b_row) * dx - c_row
                    free = opacity * _exp(power)
                    alpha = min(free, r(MAX_ALPHA))
                    alpha = alpha if power >= cut else r(0)
                    light = s[at]
                    alpha = alpha if light >= r(OPAQUE) else r(0)
                    w = alpha * light
                    s[at] = light - w
                    s[at + 2 * PIXELS] = w
                    g0, g1 = s[at + 5 * PIXELS], s[at + 6 * PIXELS]
                    g2, g3 = s[at + 7 * PIXELS], s[at + 8 * PIXELS]
                    own = (
                        s[at + 3 * PIXELS]
                        + s[at + 4 * PIXELS]
                        + g0 * v0
                        + g1 * v1
                        + g2 * v2
                        + g3 * v3
                    )
                    behind = s[at + PIXELS] - w * own
                    s[at + PIXELS] = behind
                    e = alpha * (light * own - behind / (r(1) - alpha))
                    e = e if free < r(MAX_ALPHA) else r(0)
                    sums[col] += e
                    sums[TILE + col] += e * dy
                    sums[2 * TILE + col] += e * dy * dy
                    sums[3 * TILE + col] += w * g0
                    sums[4 * TILE + col] += w * g1
                    sums[5 * TILE + col] += w * g2
                    sums[6 * TILE + col] += w * g3
                for channel in range(FIXED, channels):
                    plane, place = (5 + channel) * PIXELS + base, (3 + channel) * TILE
                    for col in range(TILE):
                        sums[place + col] += s[2 * PIXELS + base + col] * s[plane + col]
            e0, ex, ey, exx, exy, eyy = r(0), r(0), r(0), r(0), r(0), r(0)
            d0, d1, d2, d3 = r(0), r(0), r(0), r(0)
            for col in range(TILE):
                dx = r(col) - mx
                e, by_dy = sums[col], sums[TILE + col]
                e0 += e
                ex += e * dx
                ey += by_dy
                exx += e * dx * dx
                exy += by_dy * dx
                eyy += sums[2 * TILE + col]
                d0 += sums[3 * TILE + col]
                d1 += sums[4 * TILE + col]
                d2 += sums[5 * TILE + col]
                d3 += sums[6 * TILE + col]
            entry = entry_grads[k]
            entry[0], entry[1], entry[2], entry[3], entry[4], entry[5] = e0, ex, ey, exx, exy, eyy
            entry[6], entry[7], entry[8], entry[9] = d0, d1, d2, d3
            for channel in range(FIXED, channels):
                total = r(0)
                for col in range(TILE):
                    total += sums[(3 + channel) * TILE + col]
                entry[MOMENTS + channel] = total
            if (k - starts[t]) % _CHECK == 0 and _finished(s, r):
                done = k + 1
                break
        entry_grads[done : starts[t + 1]] = r(0)


@njit(**_THREAD)
def gather(splats, starts, gaussian, picture, entry_sums, first, last):
    """Fill `entry_sums` (entries, 1 + channels) of tiles `first` to `last`.

    Each row holds the sum of a Gaussian's weights (alpha times light) over the tile's pixels, and
    the sums of weight times `picture` (channels, h, w).
    """
    r = splats.dtype.type
    channels, height, width = picture.shape
    across = (width + TILE - 1) // TILE
    s = np.empty(PIXELS, splats.dtype)
    for t in range(first, last):
        x, y = t % across * TILE, t // across * TILE
        s[:] = r(1)
        for k in range(starts[t], starts[t + 1]):
            i = gaussian[k]
            entry_sums[k] = r(0)
            mx, my, a, b, c, top, bottom = _rows(splats[i], x, y, r)
            opacity, cut = splats[i, _OPACITY], splats[i, _CUT]
            for row in range(top, min(bottom, height - y - 1) + 1):
                dy = r(row) - my
                for col in range(min(TILE, width - x)):
                    dx = r(col) - mx
                    power = -(a * dx + b * dy) * dx - c * dy * dy
                    light = s[row * TILE + col]
                    if not (power >= cut and light >= r(OPAQUE)):
                        continue
                    w = light * min(opacity * _exp(power), r(MAX_ALPHA))
                    s[row * TILE + col] = light - w
                    entry_sums[k, 0] += w
                    for channel in range(channels):
                        entry_sums[k, 1 + channel] += w * picture[channel, y + row, x + col]
