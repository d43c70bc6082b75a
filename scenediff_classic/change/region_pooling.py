"""Values of pixels or feature cells, pooled over the regions of a view, and back again."""

import numpy as np
from jaxtyping import Float, Float32, Int32

from scenediff_classic.types import Regions


def region_means(
    values: Float[np.ndarray, "h w"], regions: Regions
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Mean over each region's finite values (NaN if it has none), and their share of its pixels."""
    use = np.isfinite(values) & (regions.labels >= 0)
    labels = regions.labels[use]
    counts = np.bincount(labels, minlength=regions.count).astype(float)
    sums = np.bincount(labels, values[use], minlength=regions.count)
    sizes = np.bincount(regions.labels[regions.labels >= 0], minlength=regions.count)
    means = np.divide(sums, counts, out=np.full(regions.count, np.nan), where=counts > 0)
    return means, counts / np.maximum(sizes, 1)


def paint(values: Float[np.ndarray, "n"], labels: Int32[np.ndarray, "h w"]) -> np.ndarray:
    """Every pixel gets its region's value; NaN where no region is."""
    out = np.append(values, np.nan).astype(np.float32)
    return out[labels]  # label -1 picks the appended NaN


def region_descriptors(
    grid: Float32[np.ndarray, "r k c"], regions: Regions
) -> Float32[np.ndarray, "n c"]:
    """Unit-length mean feature of each region, every cell weighted by the region's pixels in it."""
    rows, columns, channels = grid.shape
    height, width = regions.labels.shape
    row = (np.arange(height) * rows // height)[:, None]
    column = np.arange(width) * columns // width
    cell = row * columns + column
    inside = regions.labels >= 0
    # pixel counts of every (region, cell) pair, so that thin regions get their share as well
    keys, counts = np.unique(
        regions.labels[inside].astype(np.int64) * (rows * columns) + cell[inside],
        return_counts=True,
    )
    flat = grid.reshape(-1, channels).astype(np.float32)
    weighted = flat[keys % (rows * columns)] * counts[:, None].astype(np.float32)
    sums = np.zeros((regions.count, channels), np.float32)
    np.add.at(sums, keys // (rows * columns), weighted)
    return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-8)
