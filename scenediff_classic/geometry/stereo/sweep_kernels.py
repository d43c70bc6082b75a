"""The inner loops of plane-sweep stereo, compiled; `sweep_kernels_reference` holds the twins.

Costs are whole numbers from 0 to `WORST`, so that sums do not depend on their order.
"""

import numpy as np
from numba import njit, prange

WORST = 255
"""Cost of a pixel that a source does not show; the most that a matching cost can be."""

_RANGE = np.float32(WORST)
_ZERO = np.float32(0)
_ONE = np.float32(1)
_FLAGS = {"reassoc", "contract", "arcp", "nsz"}
MIN_VARIANCE = np.float32(1e-5)
"""Windows below this grey-value variance (grey in 0..1) carry no texture to match."""


@njit(cache=True, nogil=True, fastmath=_FLAGS, error_model="numpy")
def unlikeness(reference, warped, product, known, cap, costs):
    """Fill `costs` (h, w) with 1 - NCC of two pictures around each pixel; `cap` becomes `WORST`.

    Parameters
    ----------
    reference, warped : float32 arrays (2, h, w)
        Mean and variance of the grey values, 0 to 1, in the window around each pixel.
    product : float32 array (h, w)
        Mean product of both pictures' grey values.
    known : uint8 array (h, w)
        0 where either picture shows nothing.
    costs : uint8 array (h, w)
    """
    height, width = costs.shape
    scale = _RANGE / cap
    for row in range(height):
        for col in range(width):
            spread, other = reference[1, row, col], warped[1, row, col]
            covariance = product[row, col] - reference[0, row, col] * warped[0, row, col]
            enough = spread > MIN_VARIANCE and other > MIN_VARIANCE and known[row, col] != 0
            root = np.sqrt(spread * other if enough else _ONE)
            cost = scale * (_ONE - (covariance if enough else _ZERO) / root)
            cost = cost if enough else _RANGE
            costs[row, col] = np.uint8(min(max(cost, _ZERO), _RANGE))


@njit(cache=True, nogil=True)
def mean_of_best(costs, best, means):
    """Fill `means` (h, w) with the mean over the `best` lowest of `costs` (sources, h, w)."""
    count, height, width = costs.shape
    kept = min(best, count)
    for row in range(height):
        lowest = np.full((kept, width), WORST, np.uint8)
        for s in range(count):
            rest = costs[s, row].copy()
            for k in range(kept):
                for col in range(width):
                    here, new = lowest[k, col], rest[col]
                    lowest[k, col] = min(here, new)
                    rest[col] = max(here, new)
        for col in range(width):
            total = np.int32(0)
            for k in range(kept):
                total += np.int32(lowest[k, col])
            means[row, col] = total // kept


@njit(cache=True)
def path_start(number, height, width, down, right):
    """Pixel on the picture's rim from which a path of one direction starts."""
    beside = height if right != 0 else 0
    if number < beside:
        return number, (0 if right > 0 else width - 1)
    along = number - beside
    if right > 0:
        along += 1  # the corner is a start already
    return (0 if down > 0 else height - 1), along


@njit(parallel=True, cache=True)
def scan(volume, grey, down, right, small, large, contrast, totals):
    """Add to `totals` the cheapest way to reach each plane along straight paths of one direction.

    Hirschmueller's recursion: a path may keep its plane for nothing, change to the next plane for
    `small`, and to any other one for `large`, less where the picture has an edge.

    Parameters
    ----------
    volume : uint8 array (h, w, planes)
    grey : float32 array (h, w)
        0 to 1, NaN = unknown.
    down, right : int
        Step of the path, each -1, 0 or 1.
    contrast : float32
        Grey difference that halves `large`; it never falls below `small`.
    totals : uint16 array (h, w, planes)
    """
    height, width, planes = volume.shape
    starts = height * abs(right) + width * abs(down) - abs(right * down)
    for start in prange(starts):
        row, col = path_start(np.int64(start), height, width, down, right)
        costs = np.zeros(planes + 2, np.int32)  # one more on either side, for the neighbours
        costs[0] = costs[planes + 1] = 1 << 20
        ahead = costs.copy()
        least, before = np.int32(0), grey[row, col]
        while 0 <= row < height and 0 <= col < width:
            here = grey[row, col]
            step = abs(here - before)
            jump = np.int32(large)
            if step > _ZERO:  # false where a grey value is unknown
                jump = max(np.int32(large * contrast / (contrast + step)), np.int32(small))
            lowest = np.int32(1 << 20)
            for d in range(planes):
                near = min(costs[d], costs[d + 2]) + np.int32(small)
                way = min(min(costs[d + 1], near), least + jump) - least
                cost = np.int32(volume[row, col, d]) + way
                ahead[d + 1] = cost
                totals[row, col, d] += np.uint16(cost)
                lowest = min(lowest, cost)
            costs, ahead = ahead, costs
            least, before = lowest, here
            row += down
            col += right


@njit(parallel=True, cache=True)
def winners(totals, volume, planes, costs):
    """Fill `planes` (h, w) with the cheapest plane, as a fractional number; and its own cost.

    Parameters
    ----------
    totals, volume : uint16 and uint8 arrays (h, w, planes)
    planes, costs : float32 arrays (h, w)
        The fraction is the lowest point of the parabola through the total and its neighbours;
        the cost, 0 to 1, is that of the volume.
    """
    height, width, count = totals.shape
    for row in prange(height):
        for col in range(width):
            best = 0
            for d in range(1, count):
                if totals[row, col, d] < totals[row, col, best]:
                    best = d
            fraction = np.float32(0)
            if best > 0 and best < count - 1:
                before = np.float32(totals[row, col, best - 1])
                after = np.float32(totals[row, col, best + 1])
                bend = before + after - np.float32(2) * np.float32(totals[row, col, best])
                if bend > _ZERO:
                    fraction = (before - after) / (np.float32(2) * bend)
            planes[row, col] = np.float32(best) + fraction
            costs[row, col] = np.float32(volume[row, col, best]) / _RANGE
