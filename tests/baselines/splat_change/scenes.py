"""The tiny analytic scene, and Gaussians of it that need no training."""

import numpy as np

from baselines.gaussian_splatting.gaussians import Gaussians, Points
from baselines.splat_change.models import Render, prepared, renders
from scenediff_classic.types import Geometry, Video
from tests.plane_scene import Card, scene


def both(before: list[Card], after: list[Card]) -> Geometry:
    """Three views of each state, at unit extent."""
    return prepared(scene(before, after), 120)


def untrained(geometry: Geometry, video: Video) -> Gaussians:
    """A Gaussian at each pixel's place: depth is exact, so they look right from the start."""
    ids = [k for k, v in enumerate(geometry.views) if v.video == video]
    return Gaussians.start(Points.of(geometry, ids, 20_000), degree=0)


def seen_by(geometry: Geometry, now: Video) -> dict[int, Render]:
    """The other capture's model from this capture's cameras, by position of the view."""
    other: Video = "before" if now == "after" else "after"
    ids = [k for k, v in enumerate(geometry.views) if v.video == now]
    drawn = renders(untrained(geometry, other), [geometry.views[k] for k in ids])
    return dict(zip(ids, drawn, strict=True))


def silhouette(geometry: Geometry, k: int, nearer: float) -> np.ndarray:
    """Pixels of a view whose surface is nearer than a share of its farthest."""
    depth = geometry.views[k].depth
    return depth < nearer * np.nanmax(depth)


def iou(a: np.ndarray, b: np.ndarray) -> float:
    """Overlap of two masks."""
    return float((a & b).sum() / max((a | b).sum(), 1))
