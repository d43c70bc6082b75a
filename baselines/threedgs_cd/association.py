"""One identity over all views for the masks of each view: step 4 of 3DGS-CD."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from scenediff_classic.cameras import inside, project, unproject
from scenediff_classic.change.changed_regions import ChangedRegion, every
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.types import Geometry, TermScores, Video, View


@dataclass(frozen=True)
class AssociationConfig:
    """When masks of two views are the same thing."""

    alike: float = 0.8
    """Least cosine of the mean descriptors; belongs to the features (published, with another
    back-bone: 0.4)."""
    near: float = 0.02
    """Largest distance of the nearest points, in normalised units; inf = none, as published."""
    share: float = 0.25
    """A thing must be seen in more than this share of the views."""
    could_see: bool = True
    """Of the views whose picture its place is in; False = of all, as published."""
    late: bool = True
    """Things that the first view lacks gather masks as well; False = each such mask stays alone, as
    published."""
    fullest_only: bool = False
    """Of the masks in renders, use only the views with as many as the fullest one, as published."""
    keep: float = 0.98
    """Share of a mask's points, nearest to their median, that stand for its place."""
    most: int = 500
    """Points kept of a mask."""


def region(
    k: int,
    label: int,
    view: View,
    mask: Bool[np.ndarray, "h w"],
    score: float,
    grid: Float[np.ndarray, "r c f"],
    config: AssociationConfig,
) -> ChangedRegion:
    """A mask with its place in space and its looks.

    Parameters
    ----------
    view : View
        With the depth of what the mask shows: of the picture, or of the render.
    grid : array (r, c, f)
        Dense features of the same picture.
    """
    points = unproject(view)[mask]
    points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    rows, columns = np.nonzero(mask)
    height, width = mask.shape
    cells = grid[rows * grid.shape[0] // height, columns * grid.shape[1] // width]
    mean = cells.mean(axis=0)
    descriptor = (mean / max(float(np.linalg.norm(mean)), 1e-8)).astype(np.float32)
    place = central(every(points, config.most), config.keep)
    return ChangedRegion(k, label, mask, score, TermScores(0.0, 0.0, 0.0), descriptor, place)


def central(points: Float64[np.ndarray, "n 3"], keep: float) -> Float64[np.ndarray, "m 3"]:
    """The share of the points that lie nearest to their median."""
    if len(points) == 0:
        return points
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    return points[away <= np.quantile(away, keep)]


def associated(
    by_view: Sequence[Sequence[ChangedRegion]], video: Video, config: AssociationConfig
) -> list[SceneObject]:
    """Masks of all views as things: view after view, each matched as a whole.

    Parameters
    ----------
    by_view : sequence of sequences of ChangedRegion
        The masks of each view, in the order in which views are taken (see `fullest_first`).
    video : "before" or "after"
        The capture that has the things.
    """
    groups: list[list[ChangedRegion]] = []
    alone: list[list[ChangedRegion]] = []
    for number, masks in enumerate(by_view):
        taken: set[int] = set()
        if groups and masks:
            cost = np.array([[_distance(g, m) for m in masks] for g in groups])
            allowed = np.isfinite(cost) & (cost <= config.near)
            allowed &= np.array([[_alike(g, m) > config.alike for m in masks] for g in groups])
            for i, j in zip(*linear_sum_assignment(np.where(allowed, cost, 1e6)), strict=True):
                if allowed[i, j]:
                    groups[i].append(masks[j])
                    taken.add(j)
        new = [[m] for j, m in enumerate(masks) if j not in taken]
        (groups if config.late or number == 0 else alone).extend(new)
    return [SceneObject(video, tuple(g)) for g in (*groups, *alone)]


def fullest_first(
    by_view: Sequence[Sequence[ChangedRegion]], config: AssociationConfig
) -> list[Sequence[ChangedRegion]]:
    """Views by how many masks they have; without the others if only the fullest are asked for."""
    ordered = sorted(by_view, key=lambda masks: -len(masks))
    if config.fullest_only:
        return [masks for masks in ordered if len(masks) == len(ordered[0])]
    return ordered


def often_seen(
    things: Sequence[SceneObject],
    geometry: Geometry,
    views: Sequence[int],
    config: AssociationConfig,
) -> list[SceneObject]:
    """The things that enough of the given views show."""
    kept = []
    for thing in things:
        seen = {r.view for r in thing.regions}
        if config.could_see:
            could = sum(k in seen or _in_sight(thing, geometry.views[k]) for k in views)
        else:
            could = len(views)
        if len(seen) > config.share * could:
            kept.append(thing)
    return kept


def apart(first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "m 3"]) -> float:
    """Distance of the nearest points of two sets; inf if one is empty."""
    if not len(first) or not len(second):
        return float("inf")
    return float(KDTree(first).query(second)[0].min())


def _distance(group: Sequence[ChangedRegion], mask: ChangedRegion) -> float:
    return min(apart(r.points, mask.points) for r in group)


def _alike(group: Sequence[ChangedRegion], mask: ChangedRegion) -> float:
    return max(float(r.descriptor @ mask.descriptor) for r in group)


def _in_sight(thing: SceneObject, view: View) -> bool:
    xy, _ = project(thing.points, view.intrinsics, view.cam_from_world)
    return bool(len(xy)) and float(inside(xy, *view.shape).mean()) > 0.5
