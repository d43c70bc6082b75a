"""Parts of an object that its other views know of (not in the paper).

A part that looks like what stood before it stays below the threshold in one view, and is above it
in others. Where these others show the object, the region is part of it too: an object has a mask
in every view that sees it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from scenediff_classic.cameras import unproject
from scenediff_classic.change.changed_regions import (
    ChangedRegion,
    ObjectConfig,
    every,
    scored_region,
)
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.change.scoring import Scores
from scenediff_classic.types import Geometry, Regions

_SAMPLE = 300
"""Points of a region that are looked at."""
_LEAST_KNOWN = 0.5
"""Share of a region's pixels that need a depth, or nobody knows where it lies."""


def completed(
    objects: Sequence[SceneObject],
    geometry: Geometry,
    proposals: Sequence[Regions],
    scores: Scores,
    config: ObjectConfig,
) -> list[SceneObject]:
    """The objects with the regions that their other views cover; each goes to the first such one.

    Parameters
    ----------
    geometry : Geometry
        In normalised units (`change.scale.normalised`).
    proposals : sequence of Regions
        One per view.
    """
    if config.known_share > 1:
        return list(objects)
    clouds = [_clouds(item) for item in objects]
    taken = {(r.view, r.label) for item in objects for r in item.regions}
    new: list[list[ChangedRegion]] = [[] for _ in objects]
    for k, view in enumerate(geometry.views):
        points, labels = unproject(view), proposals[k].labels
        for number, item in enumerate(objects):
            others = [cloud for other, cloud in clouds[number].items() if other != k]
            if view.video != item.video or not others:
                continue
            for label in np.unique(labels[_within(points, others, config) & ~view.ignore]):
                if label < 0 or (k, label) in taken:
                    continue
                mask = (labels == label) & ~view.ignore
                if _covered(points[mask], others, config):
                    new[number].append(scored_region(k, int(label), mask, points, scores, config))
                    taken.add((k, label))
    return [
        replace(item, regions=(*item.regions, *more))
        for item, more in zip(objects, new, strict=True)
    ]


def _clouds(item: SceneObject) -> dict[int, KDTree]:
    """View -> what it knows of the object."""
    by_view: dict[int, list[np.ndarray]] = {}
    for region in item.regions:
        by_view.setdefault(region.view, []).append(region.points)
    joined = {k: np.concatenate(points) for k, points in by_view.items()}
    return {k: KDTree(points) for k, points in joined.items() if len(points)}


def _within(
    points: Float[np.ndarray, "h w 3"], clouds: Sequence[KDTree], config: ObjectConfig
) -> Bool[np.ndarray, "h w"]:
    """Which points lie in the box about the clouds: a quick first look."""
    low = np.min([cloud.mins for cloud in clouds], axis=0) - config.merge_radius
    high = np.max([cloud.maxes for cloud in clouds], axis=0) + config.merge_radius
    return ((points > low) & (points < high)).all(axis=-1)  # NaN compares as False


def _covered(
    points: Float[np.ndarray, "n 3"], clouds: Sequence[KDTree], config: ObjectConfig
) -> bool:
    """Whether enough of a region's points lie near enough of the clouds."""
    known = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    if len(known) < _LEAST_KNOWN * len(points):
        return False
    asked = every(known, _SAMPLE)
    near = [
        np.isfinite(cloud.query(asked, distance_upper_bound=config.merge_radius)[0])
        for cloud in clouds
    ]
    enough = np.sum(near, axis=0) >= config.known_views * len(clouds)
    return bool(enough.mean() >= config.known_share)
