"""Smoothing of plane hypotheses, compiled; its NumPy twin is in `kernels_reference`."""

import numpy as np
from numba import njit

from scenediff_classic.geometry.stereo.rows import over_rows


def smooth_planes(grey, planes, costs, radius, stride, sharpness, smoothed):
    """Fill `smoothed` (h, w, 3): at each pixel the median of what the planes around it say there.

    A sample counts by how well its plane matched and by how much its grey value is like the
    pixel's, so that depth follows the picture's edges rather than the matching window's. The
    plane that says the median inverse depth is taken over as a whole.
    """
    over_rows(
        _smooth_rows, costs.shape[0], grey, planes, costs, radius, stride, sharpness, smoothed
    )


@njit(nogil=True, cache=True, fastmath={"reassoc", "contract", "nsz"})
def _smooth_rows(grey, planes, costs, radius, stride, sharpness, smoothed, first, last):
    height, width = costs.shape
    samples = (2 * radius // stride + 1) ** 2
    for row in range(first, last):
        says = np.empty(samples, np.float32)  # rising
        weights = np.empty(samples, np.float32)
        origin = np.empty(samples, np.int32)
        for col in range(width):
            count = 0
            total = np.float32(0)
            for r in range(row - radius, row + radius + 1, stride):
                for c in range(col - radius, col + radius + 1, stride):
                    if r < 0 or r >= height or c < 0 or c >= width:
                        continue
                    contrast = grey[r, c] - grey[row, col]
                    match = np.float32(1) - costs[r, c]
                    alike = np.float32(1) - contrast * contrast * sharpness / np.float32(8)
                    alike = max(alike, np.float32(0))
                    alike *= alike
                    alike *= alike
                    alike *= alike  # close to exp(-contrast^2 sharpness), see `windows`
                    weight = alike * match * match
                    if not weight > 0:
                        continue
                    over, down = np.float32(col - c), np.float32(row - r)
                    said = planes[r, c, 0] + planes[r, c, 1] * over + planes[r, c, 2] * down
                    k = count
                    while k > 0 and says[k - 1] > said:
                        says[k], weights[k], origin[k] = says[k - 1], weights[k - 1], origin[k - 1]
                        k -= 1
                    says[k], weights[k], origin[k] = said, weight, r * width + c
                    total += weight
                    count += 1
            middle = 0
            passed = weights[0]
            while middle + 1 < count and passed < total / np.float32(2):
                middle += 1
                passed += weights[middle]
            source = row * width + col
            w = planes[row, col, 0]
            if count > 0 and says[middle] > 0:
                source = origin[middle]
                w = says[middle]
            smoothed[row, col, 0] = w
            smoothed[row, col, 1] = planes[source // width, source % width, 1]
            smoothed[row, col, 2] = planes[source // width, source % width, 2]
