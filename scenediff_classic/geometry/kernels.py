"""The inner loops of PatchMatch stereo, compiled with numba.

`kernels_reference` holds the readable NumPy twin of every function here; `pyramid.Pictures` is
what they work on.

A hypothesis is a plane, written as inverse depth over the reference picture:
``inverse depth = w + gx * dx + gy * dy`` at ``(dx, dy)`` pixels from the pixel that owns it.
For a plane in space this is exact, and it makes the plane-induced homography linear: with
``A = K_src R K_ref^-1`` and ``b = K_src t`` the homogeneous source position of a reference pixel
``x`` is ``A x + b * inverse_depth(x)``.

Not-a-number is used on purpose (ignored pixels), so `fastmath` may only regroup sums. It is all
one file because numba's cache does not notice a change in a function that comes from another.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, prange

UNSEEN = np.float32(1.0)
"""Cost of a source that tells nothing: outside, ignored, without texture or anti-correlated."""

MIN_VARIANCE = np.float32(1e-5)
"""Patches below this grey-value variance (grey in 0..1) carry no texture to match."""

_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_TWO = np.float32(2.0)
_ZERO = np.float32(0.0)
_NEXT = np.uint32(1)
_FLAGS = {"reassoc", "contract", "arcp", "nsz"}


class Rules(NamedTuple):
    """What a plane may be and how it is judged; fixed for one pyramid level."""

    radius: int
    """Half window: offsets run from -radius to radius."""
    stride: int
    """Distance between the samples of the window, in pixels."""
    best: int
    """A plane is judged by the mean over this many of its best sources."""
    sharpness: np.float32
    """1 / (2 sigma^2) of the bilateral weight's grey-value part."""
    nearness: np.float32
    """1 / (2 sigma^2) of the bilateral weight's distance part."""
    w_min: np.float32
    """Smallest inverse depth."""
    w_max: np.float32
    min_cosine: np.float32
    """Smallest cosine between a plane's normal and the viewing ray."""
    parallax: np.float32
    """Change of inverse depth that moves a pixel by about one pixel in the sources."""


class Work(NamedTuple):
    """Scratch arrays over the samples of the window, and `costs` over the sources."""

    dx: np.ndarray
    dy: np.ndarray
    weights: np.ndarray
    """Bilateral weights of the reference patch, sum 1."""
    weighted: np.ndarray
    """Weight times grey value minus the patch's mean."""
    fu: np.ndarray
    """Where between two columns of the source a sample falls, 0 to 1."""
    fv: np.ndarray
    index: np.ndarray
    """Flat index of the source pixel up and left of a sample."""
    values: np.ndarray
    order: np.ndarray
    """Sources, the one that matches the current plane best first."""
    costs: np.ndarray
    """Cost of the current plane in each of them, in that order."""


@njit(cache=True)
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


@njit(cache=True)
def make_work(rules, sources):
    """Room for one pixel's evaluations; every row makes its own, so that threads share none."""
    count = 2 * rules.radius // rules.stride + 1
    samples = count * count
    dx = np.empty(samples, np.float32)
    dy = np.empty(samples, np.float32)
    for k in range(samples):
        dx[k] = (k % count) * rules.stride - rules.radius
        dy[k] = (k // count) * rules.stride - rules.radius
    return Work(
        dx, dy,
        np.zeros(samples, np.float32), np.zeros(samples, np.float32),
        np.zeros(samples, np.float32), np.zeros(samples, np.float32),
        np.zeros(samples, np.int32), np.zeros(samples, np.float32),
        np.zeros(sources, np.int32), np.zeros(sources, np.float32),
    )  # fmt: skip


@njit(cache=True, fastmath=_FLAGS)
def load_patch(reference, row, col, rules, work):
    """Bilateral weights (sum 1) and weight times centred grey value around a pixel, into `work`.

    Returns the weighted variance of the patch; -1 if the pixel itself is ignored.
    """
    height, width = reference.shape
    centre = reference[row, col]
    if centre != centre:
        return np.float32(-1.0)
    total = _ZERO
    mean = _ZERO
    for k in range(work.dx.shape[0]):
        r = min(max(row + int(work.dy[k]), 0), height - 1)
        c = min(max(col + int(work.dx[k]), 0), width - 1)
        value = reference[r, c] - centre
        distance = work.dx[k] * work.dx[k] + work.dy[k] * work.dy[k]
        weight = np.exp(-value * value * rules.sharpness - distance * rules.nearness)
        if value != value:
            weight, value = _ZERO, _ZERO
        work.weights[k] = weight
        work.weighted[k] = value
        total += weight
        mean += weight * value
    mean /= total  # the centre's own neighbourhood: never 0
    variance = _ZERO
    for k in range(work.dx.shape[0]):
        work.weights[k] /= total
        centred = work.weighted[k] - mean
        work.weighted[k] = work.weights[k] * centred
        variance += work.weighted[k] * centred
    return variance


@njit(cache=True, fastmath=_FLAGS, error_model="numpy")
def source_cost(image, height, width, warp, x, y, w, gx, gy, centre, variance, rules, work):
    """1 - bilaterally weighted NCC of the patch around (x, y), under a plane, in one source.

    `centre` is the reference's grey value at (x, y): subtracted, it spares float32 the rounding.
    """
    u0 = warp[0, 0] * x + warp[0, 1] * y + warp[0, 2] + warp[0, 3] * w
    v0 = warp[1, 0] * x + warp[1, 1] * y + warp[1, 2] + warp[1, 3] * w
    z0 = warp[2, 0] * x + warp[2, 1] * y + warp[2, 2] + warp[2, 3] * w
    ux, uy = warp[0, 0] + warp[0, 3] * gx, warp[0, 1] + warp[0, 3] * gy
    vx, vy = warp[1, 0] + warp[1, 3] * gx, warp[1, 1] + warp[1, 3] * gy
    zx, zy = warp[2, 0] + warp[2, 3] * gx, warp[2, 1] + warp[2, 3] * gy
    if not z0 - np.float32(rules.radius) * (abs(zx) + abs(zy)) > _ZERO:
        return UNSEEN  # some of the patch is behind the source
    limit_u, limit_v = np.float32(width), np.float32(height)
    if not (u0 >= _ZERO and u0 < limit_u * z0 and v0 >= _ZERO and v0 < limit_v * z0):
        return UNSEEN
    last_u, last_v = np.float32(width - 1), np.float32(height - 1)
    columns, pitch = np.int32(image.shape[1]), np.uint32(image.shape[1])
    dxs, dys, weights, weighted, fu, fv, index, values, _, _ = work
    samples = dxs.shape[0]
    for k in range(samples):  # three loops: the compiler can vectorise the first and the last
        scale = _ONE / (z0 + dxs[k] * zx + dys[k] * zy)
        u = (u0 + dxs[k] * ux + dys[k] * uy) * scale - _HALF
        v = (v0 + dxs[k] * vx + dys[k] * vy) * scale - _HALF
        u = u if u > _ZERO else _ZERO  # a NaN becomes 0 here: no index can leave the picture
        v = v if v > _ZERO else _ZERO
        u = u if u < last_u else last_u
        v = v if v < last_v else last_v
        left, top = np.int32(u), np.int32(v)
        fu[k] = u - np.float32(left)
        fv[k] = v - np.float32(top)
        index[k] = np.int32(np.int32(top * columns) + left)
    flat = image.ravel()
    for k in range(samples):  # unsigned: numba adds no test for negative indices
        i = np.uint32(index[k])
        upper, lower = flat[i], flat[np.uint32(i + pitch)]
        upper += fu[k] * (flat[np.uint32(i + _NEXT)] - upper)
        lower += fu[k] * (flat[np.uint32(i + pitch + _NEXT)] - lower)
        values[k] = upper + fv[k] * (lower - upper) - centre
    mean, square, product = _ZERO, _ZERO, _ZERO
    for k in range(samples):
        value = values[k]
        part = weights[k] * value
        mean += part
        square += part * value
        product += weighted[k] * value
    spread = square - mean * mean
    if not spread > MIN_VARIANCE:
        return UNSEEN
    cost = _ONE - product / np.sqrt(spread * variance)
    return cost if cost < UNSEEN else UNSEEN


@njit(cache=True, fastmath=_FLAGS)
def rank_sources(pictures, row, col, w, gx, gy, variance, rules, work):
    """Sort the sources by the cost of a plane in them, and judge the plane by the best few."""
    x, y = np.float32(col) + _HALF, np.float32(row) + _HALF
    count = pictures.sources.shape[0]
    for s in range(count):
        cost = UNSEEN
        if variance > MIN_VARIANCE:
            cost = source_cost(
                pictures.sources[s], pictures.sizes[s, 0], pictures.sizes[s, 1], pictures.warps[s],
                x, y, w, gx, gy, pictures.reference[row, col], variance, rules, work,
            )  # fmt: skip
        k = s
        while k > 0 and work.costs[k - 1] > cost:
            work.costs[k], work.order[k] = work.costs[k - 1], work.order[k - 1]
            k -= 1
        work.costs[k], work.order[k] = cost, s
    kept = min(rules.best, count)
    return np.mean(work.costs[:kept])


@njit(cache=True, fastmath=_FLAGS)
def plane_cost(pictures, row, col, w, gx, gy, variance, bound, rules, work):
    """Mean cost of a plane over the best sources of `rank_sources`.

    Stops early, with a value of at least `bound`, once it cannot be lower than that.
    """
    x, y = np.float32(col) + _HALF, np.float32(row) + _HALF
    kept = min(rules.best, pictures.sources.shape[0])
    total = _ZERO
    for i in range(kept):
        s = work.order[i]
        total += source_cost(
            pictures.sources[s], pictures.sizes[s, 0], pictures.sizes[s, 1], pictures.warps[s],
            x, y, w, gx, gy, pictures.reference[row, col], variance, rules, work,
        )  # fmt: skip
        if total >= bound * np.float32(kept):
            break
    return total / np.float32(kept)


@njit(cache=True, fastmath=_FLAGS)
def allowed(camera, x, y, w, gx, gy, rules):
    """True for a plane inside the depth range that is not seen too edge-on."""
    if not (w >= rules.w_min and w <= rules.w_max):
        return False
    ray_x, ray_y = (x - camera[2]) / camera[0], (y - camera[3]) / camera[1]
    nx, ny = gx * camera[0], gy * camera[1]
    nz = w - nx * ray_x - ny * ray_y  # (nx, ny, nz) . ray = w: the plane's normal over its distance
    lengths = (nx * nx + ny * ny + nz * nz) * (ray_x * ray_x + ray_y * ray_y + _ONE)
    return w * w >= rules.min_cosine * rules.min_cosine * lengths


@njit(parallel=True, cache=True, fastmath=_FLAGS)
def score_planes(pictures, rules, planes, costs):
    """Fill `costs` (h, w) with the cost of every pixel's own plane in `planes` (h, w, 3)."""
    height, width = costs.shape
    for row in prange(height):
        work = make_work(rules, pictures.sources.shape[0])
        for col in range(width):
            variance = load_patch(pictures.reference, row, col, rules, work)
            plane = planes[row, col]
            costs[row, col] = rank_sources(
                pictures, row, col, plane[0], plane[1], plane[2], variance, rules, work
            )


@njit(parallel=True, cache=True, fastmath=_FLAGS)
def sweep(pictures, rules, planes, costs, offsets, colour, amplitude, explore, seed):
    """Improve in place the planes of one colour of the checkerboard.

    Every pixel tries the best plane of each group of neighbours, `explore` random depths, and
    three perturbations of its best plane so far.

    Parameters
    ----------
    planes, costs : arrays (h, w, 3) and (h, w), float32
    offsets : int32 array (groups, n, 2)
        (row, column) steps to neighbours of the other colour: |row| + |column| must be odd, so
        that no thread reads what another one writes.
    colour : 0 or 1
    amplitude : float32
        Largest perturbation, in pixels of parallax.
    """
    height, width = costs.shape
    same = np.float32(0.02) * rules.parallax
    step = amplitude * rules.parallax
    tilt = step / np.float32(rules.radius)
    for row in prange(height):
        work = make_work(rules, pictures.sources.shape[0])
        y = np.float32(row) + _HALF
        for col in range((row + colour) % 2, width, 2):
            x = np.float32(col) + _HALF
            variance = load_patch(pictures.reference, row, col, rules, work)
            if not variance > MIN_VARIANCE:
                adopt_best_neighbour(planes, costs, offsets, row, col, pictures.camera, rules)
                continue
            w, gx, gy = planes[row, col, 0], planes[row, col, 1], planes[row, col, 2]
            best = rank_sources(pictures, row, col, w, gx, gy, variance, rules, work)
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
                    cost = plane_cost(pictures, row, col, t, tx, ty, variance, best, rules, work)
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
                    cost = plane_cost(pictures, row, col, t, tx, ty, variance, best, rules, work)
                    if cost < best:
                        best, w, gx, gy = cost, t, tx, ty
            planes[row, col, 0], planes[row, col, 1], planes[row, col, 2] = w, gx, gy
            costs[row, col] = best


@njit(cache=True)
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


@njit(cache=True)
def adopt_best_neighbour(planes, costs, offsets, row, col, camera, rules):
    """Give a pixel that cannot be matched the plane of its cheapest neighbour; cost stays."""
    best = UNSEEN
    for group in range(offsets.shape[0]):
        r, c = best_neighbour(costs, offsets, group, row, col)
        if r < 0 or not costs[r, c] < best:
            continue
        tx, ty = planes[r, c, 1], planes[r, c, 2]
        t = planes[r, c, 0] + tx * np.float32(col - c) + ty * np.float32(row - r)
        if allowed(camera, np.float32(col) + _HALF, np.float32(row) + _HALF, t, tx, ty, rules):
            best = costs[r, c]
            planes[row, col, 0], planes[row, col, 1], planes[row, col, 2] = t, tx, ty
