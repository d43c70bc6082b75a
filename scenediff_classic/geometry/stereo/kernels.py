"""The inner loops of PatchMatch stereo, compiled with numba.

`kernels_reference` holds the readable NumPy twin of every function here; they work on
`pyramid.Pictures` and `windows.Windows`.

A hypothesis is a plane, written as inverse depth over the reference picture:
``inverse depth = w + gx * dx + gy * dy`` at ``(dx, dy)`` pixels from the pixel that owns it.
For a plane in space this is exact, and it makes the plane-induced homography linear: with
``A = K_src R K_ref^-1`` and ``b = K_src t`` the homogeneous source position of a reference pixel
``x`` is ``A x + b * inverse_depth(x)``.

Not-a-number is used on purpose (ignored pixels), so `fastmath` may only regroup sums. It is all
one file because numba's cache does not notice a change in a function that comes from another.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from scenediff_classic.geometry.stereo.rows import over_rows

UNSEEN = np.float32(1.0)
"""1 - NCC of a source that tells nothing: outside, ignored, without texture, anti-correlated."""

MIN_VARIANCE = np.float32(1e-5)
"""Patches below this grey-value variance (grey in 0..1) carry no texture to match."""

_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_ZERO = np.float32(0.0)
_NEXT = np.uint32(1)
_FLAGS = {"reassoc", "contract", "arcp", "nsz"}
_PLAIN: dict[str, Any] = {"_nrt": False, "cache": True}
_FAST: dict[str, Any] = {**_PLAIN, "fastmath": _FLAGS}
_INLINE: dict[str, Any] = {**_FAST, "forceinline": True, "error_model": "numpy"}
_ROWS: dict[str, Any] = {**_FAST, "nogil": True}
# `_nrt`: without it, every call counts references to some twenty arrays, which takes longer than
# the matching itself; kernels then cannot make arrays and get their scratch room from outside.


class Rules(NamedTuple):
    """What a plane may be and how it is judged; fixed for one pyramid level."""

    radius: int
    """Half window: offsets run from -radius to radius."""
    best: int
    """A plane is judged by the mean over this many of its best sources."""
    w_min: np.float32
    """Smallest inverse depth."""
    w_max: np.float32
    min_cosine: np.float32
    """Smallest cosine between a plane's normal and the viewing ray."""
    cap: np.float32
    """Largest cost that a single source contributes."""
    consistency: np.float32
    """Cost of a plane that a source's own depth contradicts entirely; 0 = depth is not compared."""
    tolerance: np.float32
    """Forward-backward error, in pixels, that counts as an entire contradiction."""
    parallax: np.float32
    """Change of inverse depth that moves a pixel by about one pixel in the sources."""


class Work(NamedTuple):
    """Scratch arrays over the sources of one pixel."""

    order: np.ndarray
    """Sources, the one that matches the current plane best first."""
    costs: np.ndarray
    """Cost of the current plane in each of them, in that order."""


@njit(**_PLAIN)
def random_unit(seed, pixel, draw):
    """Random number in [0, 1) that depends on its arguments only, not on any thread's state."""
    mask = np.uint64(0xFFFFFFFF)
    x = (np.uint64(seed) * np.uint64(0x9E3779B1) + np.uint64(pixel)) & mask
    x = (x * np.uint64(0x85EBCA6B) + np.uint64(draw)) & mask
    for _ in range(2):
        x ^= x >> np.uint64(16)
        x = (x * np.uint64(0x45D9F3B)) & mask
    x ^= x >> np.uint64(16)
    return np.float32(x >> np.uint64(8)) * np.float32(2.0**-24)


def make_work(height, sources):
    """Room for the evaluations of every row: rows share none, so neither do threads."""
    return Work(np.zeros((height, sources), np.int32), np.zeros((height, sources), np.float32))


def flattened(pictures):
    """The pictures with each source as one row of pixels, and how many of them make a row."""
    count, _, pitch = pictures.sources.shape
    return pictures._replace(sources=pictures.sources.reshape(count, -1)), pitch


@njit(**_INLINE)
def source_cost(
    flat, pitch, height, width, warp, x, y, w, gx, gy, centre, variance, weights, weighted,
    dxs, dys, reach,
):  # fmt: skip
    """1 - bilaterally weighted NCC of the patch around (x, y), under a plane, in one source.

    `centre` is the reference's grey value at (x, y): subtracted, it spares float32 the rounding.
    Within the window the plane's homography is replaced by its derivative at the centre.
    """
    z0 = warp[2, 0] * x + warp[2, 1] * y + warp[2, 2] + warp[2, 3] * w
    zx, zy = warp[2, 0] + warp[2, 3] * gx, warp[2, 1] + warp[2, 3] * gy
    if not z0 - reach * (abs(zx) + abs(zy)) > _ZERO:
        return UNSEEN  # some of the patch is behind the source
    scale = _ONE / z0
    u0 = (warp[0, 0] * x + warp[0, 1] * y + warp[0, 2] + warp[0, 3] * w) * scale
    v0 = (warp[1, 0] * x + warp[1, 1] * y + warp[1, 2] + warp[1, 3] * w) * scale
    limit_u, limit_v = np.float32(width), np.float32(height)
    if not (u0 >= _ZERO and u0 < limit_u and v0 >= _ZERO and v0 < limit_v):
        return UNSEEN
    ux = (warp[0, 0] + warp[0, 3] * gx - u0 * zx) * scale
    uy = (warp[0, 1] + warp[0, 3] * gy - u0 * zy) * scale
    vx = (warp[1, 0] + warp[1, 3] * gx - v0 * zx) * scale
    vy = (warp[1, 1] + warp[1, 3] * gy - v0 * zy) * scale
    u0 -= _HALF
    v0 -= _HALF
    last_u, last_v = limit_u - _ONE, limit_v - _ONE
    columns, pitch = np.int32(pitch), np.uint32(pitch)
    samples = dxs.shape[0]
    mean, square, product = _ZERO, _ZERO, _ZERO
    for k in range(samples):  # without any store, so that the compiler can vectorise all of it
        u = u0 + dxs[k] * ux + dys[k] * uy
        v = v0 + dxs[k] * vx + dys[k] * vy
        u = u if u > _ZERO else _ZERO  # a NaN becomes 0 here: no index can leave the picture
        v = v if v > _ZERO else _ZERO
        u = u if u < last_u else last_u
        v = v if v < last_v else last_v
        left, top = np.int32(u), np.int32(v)
        fu = u - np.float32(left)
        fv = v - np.float32(top)
        i = np.uint32(np.int32(np.int32(top * columns) + left))  # unsigned: no test for below 0
        upper, lower = flat[i], flat[np.uint32(i + pitch)]
        upper += fu * (flat[np.uint32(i + _NEXT)] - upper)
        lower += fu * (flat[np.uint32(i + pitch + _NEXT)] - lower)
        value = upper + fv * (lower - upper) - centre
        part = weights[k] * value
        mean += part
        square += part * value
        product += weighted[k] * value
    spread = square - mean * mean
    if not spread > MIN_VARIANCE:
        return UNSEEN
    cost = _ONE - product / np.sqrt(spread * variance)
    return cost if cost < UNSEEN else UNSEEN


@njit(**_INLINE)
def disagreement(depths, height, width, warp, back, x, y, w, tolerance):
    """Forward-backward error of a depth against a source's own one, as a share of `tolerance`."""
    scale = _ONE / (warp[2, 0] * x + warp[2, 1] * y + warp[2, 2] + warp[2, 3] * w)
    u = (warp[0, 0] * x + warp[0, 1] * y + warp[0, 2] + warp[0, 3] * w) * scale
    v = (warp[1, 0] * x + warp[1, 1] * y + warp[1, 2] + warp[1, 3] * w) * scale
    if not (u >= _ZERO and u < np.float32(width) and v >= _ZERO and v < np.float32(height)):
        return _ONE
    there = depths[np.int32(v), np.int32(u)]
    if not there > _ZERO:
        return _ONE
    scale = _ONE / (back[2, 0] * u + back[2, 1] * v + back[2, 2] + back[2, 3] * there)
    dx = (back[0, 0] * u + back[0, 1] * v + back[0, 2] + back[0, 3] * there) * scale - x
    dy = (back[1, 0] * u + back[1, 1] * v + back[1, 2] + back[1, 3] * there) * scale - y
    error = np.sqrt(dx * dx + dy * dy) / tolerance
    return error if error < _ONE else _ONE


@njit(**_INLINE)
def cost_in(source, pictures, pitch, windows, rules, row, col, w, gx, gy):
    """Cost of a plane in one source: how unlike it looks there, and what its depth there says."""
    x, y = np.float32(col) + _HALF, np.float32(row) + _HALF
    cost = rules.cap
    if windows.variance[row, col] > MIN_VARIANCE:
        unlikeness = source_cost(
            pictures.sources[source], pitch, pictures.sizes[source, 0],
            pictures.sizes[source, 1], pictures.warps[source], x, y, w, gx, gy,
            pictures.reference[row, col],
            windows.variance[row, col], windows.weights[row, col], windows.weighted[row, col],
            windows.dx, windows.dy, np.float32(rules.radius),
        )  # fmt: skip
        cost = min(unlikeness, rules.cap)
    if rules.consistency > _ZERO:
        cost += rules.consistency * disagreement(
            pictures.depths[source], pictures.sizes[source, 0], pictures.sizes[source, 1],
            pictures.warps[source], pictures.returns[source], x, y, w, rules.tolerance,
        )  # fmt: skip
    return cost


@njit(**_INLINE)
def rank_sources(pictures, pitch, windows, rules, row, col, w, gx, gy, work):
    """Sort the sources by the cost of a plane in them, and judge the plane by the best few."""
    count = pictures.sources.shape[0]
    for source in range(count):
        cost = cost_in(source, pictures, pitch, windows, rules, row, col, w, gx, gy)
        k = source
        while k > 0 and work.costs[k - 1] > cost:
            work.costs[k], work.order[k] = work.costs[k - 1], work.order[k - 1]
            k -= 1
        work.costs[k], work.order[k] = cost, source
    kept = min(rules.best, count)
    total = _ZERO
    for k in range(kept):
        total += work.costs[k]
    return total / np.float32(kept)


@njit(**_INLINE)
def plane_cost(pictures, pitch, windows, rules, row, col, w, gx, gy, bound, work):
    """Mean cost of a plane over the best sources of `rank_sources`.

    Stops early, with a value of at least `bound`, once it cannot be lower than that.
    """
    kept = min(rules.best, pictures.sources.shape[0])
    total = _ZERO
    for k in range(kept):
        total += cost_in(work.order[k], pictures, pitch, windows, rules, row, col, w, gx, gy)
        if total >= bound * np.float32(kept):
            break
    return total / np.float32(kept)


@njit(**_FAST)
def allowed(camera, x, y, w, gx, gy, rules):
    """True for a plane inside the depth range that is not seen too edge-on."""
    if not (w >= rules.w_min and w <= rules.w_max):
        return False
    ray_x, ray_y = (x - camera[2]) / camera[0], (y - camera[3]) / camera[1]
    nx, ny = gx * camera[0], gy * camera[1]
    nz = w - nx * ray_x - ny * ray_y  # (nx, ny, nz) . ray = w: the plane's normal over its distance
    lengths = (nx * nx + ny * ny + nz * nz) * (ray_x * ray_x + ray_y * ray_y + _ONE)
    return w * w >= rules.min_cosine * rules.min_cosine * lengths


def score_planes(pictures, windows, rules, planes, costs):
    """Fill `costs` (h, w) with the cost of every pixel's own plane in `planes` (h, w, 3)."""
    work = make_work(len(costs), len(pictures.sources))
    flat, pitch = flattened(pictures)
    over_rows(_score_rows, len(costs), flat, pitch, windows, rules, planes, costs, work)


@njit(**_ROWS)
def _score_rows(pictures, pitch, windows, rules, planes, costs, scratch, first, last):
    width = costs.shape[1]
    for row in range(first, last):
        work = Work(scratch.order[row], scratch.costs[row])
        for col in range(width):
            plane = planes[row, col]
            costs[row, col] = rank_sources(
                pictures, pitch, windows, rules, row, col, plane[0], plane[1], plane[2], work
            )


def sweep(
    pictures, windows, rules, planes, costs, settled, offsets, colour, amplitude, explore, seed
):
    """Improve in place the planes of one colour of the checkerboard.

    Every pixel tries the best plane of each group of neighbours, `explore` random depths, and
    three perturbations of its best plane so far.

    Parameters
    ----------
    planes, costs : arrays (h, w, 3) and (h, w), float32
    settled : bool array (h, w)
        Pixels that keep their plane; they still hand it on.
    offsets : int32 array (groups, n, 2)
        (row, column) steps to neighbours of the other colour: |row| + |column| must be odd, so
        that no thread reads what another one writes.
    colour : 0 or 1
    amplitude : float32
        Largest perturbation, in pixels of parallax.
    """
    work = make_work(len(costs), len(pictures.sources))
    flat, pitch = flattened(pictures)
    over_rows(
        _sweep_rows, len(costs), flat, pitch, windows, rules, planes, costs, settled, offsets,
        colour, amplitude, explore, seed, work,
    )  # fmt: skip


@njit(**_ROWS)
def _sweep_rows(
    pictures, pitch, windows, rules, planes, costs, settled, offsets, colour, amplitude, explore,
    seed, scratch, first, last,
):  # fmt: skip
    width = costs.shape[1]
    same = np.float32(0.02) * rules.parallax
    step = amplitude * rules.parallax
    tilt = step / np.float32(rules.radius)
    for row in range(first, last):
        work = Work(scratch.order[row], scratch.costs[row])
        y = np.float32(row) + _HALF
        for col in range((row + colour) % 2, width, 2):
            if settled[row, col]:
                continue
            x = np.float32(col) + _HALF
            if not windows.variance[row, col] > MIN_VARIANCE:
                adopt_best_neighbour(planes, costs, offsets, row, col, pictures.camera, rules)
                continue
            w, gx, gy = planes[row, col, 0], planes[row, col, 1], planes[row, col, 2]
            best = rank_sources(pictures, pitch, windows, rules, row, col, w, gx, gy, work)
            for group in range(offsets.shape[0]):
                r, c = best_neighbour(costs, offsets, group, row, col)
                if r < 0:
                    continue
                tx, ty = planes[r, c, 1], planes[r, c, 2]
                t = planes[r, c, 0] + tx * np.float32(col - c) + ty * np.float32(row - r)
                change = abs(tx - gx) + abs(ty - gy)
                if abs(t - w) + np.float32(rules.radius) * change < same:
                    continue  # nothing new: spare the evaluation
                if allowed(pictures.camera, x, y, t, tx, ty, rules):
                    cost = plane_cost(
                        pictures, pitch, windows, rules, row, col, t, tx, ty, best, work
                    )
                    if cost < best:
                        best, w, gx, gy = cost, t, tx, ty
            pixel = row * width + col
            draw = 0
            for trial in range(explore + 3):
                t, tx, ty = w, gx, gy
                if trial < explore:
                    t = rules.w_min + (rules.w_max - rules.w_min) * random_unit(seed, pixel, draw)
                    tx, ty = gx * t / w, gy * t / w  # same normal at another depth
                else:
                    if trial != explore:
                        tx += tilt * (_TWO * random_unit(seed, pixel, draw + 1) - _ONE)
                        ty += tilt * (_TWO * random_unit(seed, pixel, draw + 2) - _ONE)
                    if trial != explore + 1:
                        t += step * (_TWO * random_unit(seed, pixel, draw) - _ONE)
                draw += 3
                if allowed(pictures.camera, x, y, t, tx, ty, rules):
                    cost = plane_cost(
                        pictures, pitch, windows, rules, row, col, t, tx, ty, best, work
                    )
                    if cost < best:
                        best, w, gx, gy = cost, t, tx, ty
            planes[row, col, 0], planes[row, col, 1], planes[row, col, 2] = w, gx, gy
            costs[row, col] = best


@njit(**_PLAIN)
def best_neighbour(costs, offsets, group, row, col):
    """Position of the cheapest neighbour of one group; (-1, -1) if all lie outside."""
    height, width = costs.shape
    best = np.float32(np.inf)
    found_row, found_col = -1, -1
    for i in range(offsets.shape[1]):
        r, c = row + offsets[group, i, 0], col + offsets[group, i, 1]
        if r >= 0 and r < height and c >= 0 and c < width and costs[r, c] < best:
            best = costs[r, c]
            found_row, found_col = r, c
    return found_row, found_col


@njit(**_PLAIN)
def adopt_best_neighbour(planes, costs, offsets, row, col, camera, rules):
    """Give a pixel that cannot be matched the plane of its cheapest neighbour; cost stays."""
    best = costs[row, col]
    for group in range(offsets.shape[0]):
        r, c = best_neighbour(costs, offsets, group, row, col)
        if r < 0 or not costs[r, c] < best:
            continue
        tx, ty = planes[r, c, 1], planes[r, c, 2]
        t = planes[r, c, 0] + tx * np.float32(col - c) + ty * np.float32(row - r)
        if allowed(camera, np.float32(col) + _HALF, np.float32(row) + _HALF, t, tx, ty, rules):
            best = costs[r, c]
            planes[row, col, 0], planes[row, col, 1], planes[row, col, 2] = t, tx, ty
