"""NumPy twins of `sweep_kernels`, for tests and for reading."""

import numpy as np

from scenediff_classic.geometry.stereo.sweep_kernels import MIN_VARIANCE, WORST


def unlikeness(reference, warped, product, known, cap):
    """See `sweep_kernels.unlikeness`; returns the costs."""
    (mean, spread), (other_mean, other_spread) = reference, warped
    enough = (spread > MIN_VARIANCE) & (other_spread > MIN_VARIANCE) & (known != 0)
    root = np.sqrt(np.where(enough, spread * other_spread, 1))
    cost = np.where(enough, 1 - (product - mean * other_mean) / root, cap)
    return np.clip(cost / cap * WORST, 0, WORST).astype(np.uint8)


def mean_of_best(costs, best):
    """See `sweep_kernels.mean_of_best`; returns the means."""
    lowest = np.sort(costs, axis=0)[:best].astype(np.int64)
    return (lowest.sum(axis=0) // len(lowest)).astype(np.uint8)


def scan(volume, grey, down, right, small, large, contrast):
    """See `sweep_kernels.scan`; returns what it adds to the totals."""
    height, width, _ = volume.shape
    totals = volume.astype(np.int64)
    for row in range(height)[:: -1 if down < 0 else 1]:
        for col in range(width)[:: -1 if right < 0 else 1]:
            r, c = row - down, col - right
            if not (0 <= r < height and 0 <= c < width):
                continue
            before = totals[r, c]
            step = np.nan_to_num(np.abs(grey[row, col] - grey[r, c]))
            jump = max(int(np.float32(large * contrast / (contrast + step))), small)
            far = np.full(1, 1 << 20)
            beside = np.minimum(np.r_[far, before[:-1]], np.r_[before[1:], far]) + small
            way = np.minimum(np.minimum(before, beside), before.min() + jump)
            totals[row, col] += way - before.min()
    return totals.astype(np.uint16)


def winners(totals, volume):
    """See `sweep_kernels.winners`; returns fractional plane numbers and costs."""
    best = np.argmin(totals, axis=2)
    count = totals.shape[2]

    def at(numbers):
        chosen = np.clip(numbers, 0, count - 1)[..., None]
        return np.take_along_axis(totals, chosen, axis=2)[..., 0].astype(np.float64)

    before, after = at(best - 1), at(best + 1)
    bend = before + after - 2 * at(best)
    inner = (best > 0) & (best < count - 1) & (bend > 0)
    fraction = np.where(inner, (before - after) / (2 * np.where(inner, bend, 1)), 0)
    cost = np.take_along_axis(volume, best[..., None], axis=2)[..., 0]
    return (best + fraction).astype(np.float32), cost.astype(np.float32) / np.float32(WORST)
