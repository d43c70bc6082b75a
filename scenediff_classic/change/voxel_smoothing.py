"""Scores pooled over the views of a capture, by where they lie in space (paper Sec. 4.3)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from scenediff_classic.cameras import unproject
from scenediff_classic.change.region_pooling import paint, region_means
from scenediff_classic.types import VIDEOS, Regions, View


def smooth_in_3d(
    views: Sequence[View],
    regions: Sequence[Regions],
    totals: Sequence[Float32[np.ndarray, "h w"]],
    voxel: float,
    min_visible: float,
) -> list[Float32[np.ndarray, "h w"]]:
    """Average within voxels over each capture's views, then over regions again (Sec. 4.3).

    Parameters
    ----------
    totals : sequence of float arrays
        Weighted sum of the terms, by view; NaN = not comparable.
    voxel : float
        Side of a voxel, in the unit of the cameras.
    min_visible : float
        Regions with a smaller comparable part get 0.
    """
    out: list[np.ndarray] = list(totals)
    for video in VIDEOS:
        members = [k for k, v in enumerate(views) if v.video == video]
        points = [unproject(views[k]) for k in members]
        known = [
            np.isfinite(totals[k]) & np.isfinite(p[..., 0])
            for k, p in zip(members, points, strict=True)
        ]
        if not any(k.any() for k in known):
            continue
        cells = np.concatenate([np.floor(p[k] / voxel) for p, k in zip(points, known, strict=True)])
        values = np.concatenate([totals[k][m] for k, m in zip(members, known, strict=True)])
        cells = (cells - cells.min(axis=0)).astype(np.int64)
        spans = cells.max(axis=0) + 1
        keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
        _, owner = np.unique(keys, return_inverse=True)
        mean = (np.bincount(owner, values) / np.bincount(owner))[owner]
        parts = np.split(mean, np.cumsum([k.sum() for k in known])[:-1])
        for k, mask, part in zip(members, known, parts, strict=True):
            written = np.full(totals[k].shape, np.nan, np.float32)
            written[mask] = part
            pooled, visible = region_means(written, regions[k])
            pooled[visible < min_visible] = 0
            out[k] = paint(pooled, regions[k].labels)
    return out
