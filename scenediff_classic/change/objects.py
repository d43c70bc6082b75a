"""From changed regions to changed objects with one identity over all views (paper Sec. 4.3)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float64
from scipy.spatial import KDTree

from scenediff_classic.cameras import project, sample
from scenediff_classic.change.changed_regions import (
    ChangedRegion,
    ObjectConfig,
    every,
    pair_scores,
)
from scenediff_classic.change.contact import Border, Part, adopted, borders, joined
from scenediff_classic.types import VIDEOS, Geometry, Regions, Video, View


@dataclass(frozen=True)
class SceneObject:
    """A changed thing of one capture, seen in one or more views."""

    video: Video
    regions: tuple[ChangedRegion, ...]

    @property
    def points(self) -> Float64[np.ndarray, "n 3"]:
        """Points of all its regions."""
        return np.concatenate([r.points for r in self.regions])

    @property
    def descriptor(self) -> Float[np.ndarray, "c"]:
        """Mean of its regions' descriptors, weighted by area, at unit length."""
        return _mean_descriptor(self.regions)


def group_objects(
    geometry: Geometry,
    proposals: Sequence[Regions],
    regions: Sequence[ChangedRegion],
    threshold: float,
    merge_threshold: float,
    config: ObjectConfig,
) -> list[SceneObject]:
    """Merge regions of each capture that are views, or parts, of the same thing.

    Views of the same thing by eq. 5 and 6; regions are taken from the most to the least certain,
    so the outcome does not depend on the order of the frames. In two-photo mode each region
    stays an object of its own (Sec. 4.4). Then parts that touch are joined.
    """
    objects = []
    for video in VIDEOS:
        seen = [r for r in regions if geometry.views[r.view].video == video]
        own = [r for r in seen if r.score > threshold]
        own.sort(key=lambda r: (-r.score, -r.area, float(r.points.sum())))
        if len(geometry.views) > 2:
            groups = _associated(own, merge_threshold, config)
        else:
            groups = [[r] for r in own]
        groups = _joined(groups, geometry, proposals, config)
        weak = [r for r in seen if r.score <= threshold]
        groups = _with_weak_parts(groups, weak, geometry, proposals, config)
        objects += established(groups, geometry, threshold, config)
    return objects


def established(
    groups: Sequence[Sequence[ChangedRegion]],
    geometry: Geometry,
    threshold: float,
    config: ObjectConfig,
) -> list[SceneObject]:
    """The groups, each of one capture, that enough views show and clearly enough: as objects."""
    objects = []
    for group in groups:
        shown = _visible(group, geometry, config)
        if shown and _is_convincing(shown, geometry, threshold, config):
            video = geometry.views[shown[0].view].video
            objects.append(SceneObject(video, tuple(_thinned(shown, config))))
    return objects


def similarity(
    group: Sequence[ChangedRegion], others: Sequence[ChangedRegion], config: ObjectConfig
) -> float:
    """S of eq. 5 between two sets of regions: descriptor cosine + share of `others` near `group`.

    -inf if their points share too little to be one thing.
    """
    points = np.concatenate([r.points for r in group])
    new = np.concatenate([every(r.points, config.max_points // 4) for r in others])
    if len(points) == 0 or len(new) == 0:
        return -np.inf
    reach = config.merge_radius
    apart = np.maximum(points.min(axis=0) - new.max(axis=0), new.min(axis=0) - points.max(axis=0))
    if np.any(apart > reach):
        return -np.inf
    near = KDTree(points).query(new, distance_upper_bound=reach)[0]
    overlap = float(np.isfinite(near).mean())
    if overlap < config.min_overlap:
        return -np.inf
    return float(_mean_descriptor(group) @ _mean_descriptor(others)) + overlap


def _associated(
    regions: Sequence[ChangedRegion], least: float, config: ObjectConfig
) -> list[list[ChangedRegion]]:
    groups: list[list[ChangedRegion]] = []
    for region in _thinned(regions, config):
        scores = [similarity(g, [region], config) for g in groups]
        best = int(np.argmax(scores)) if scores else -1
        if best >= 0 and scores[best] > least:
            groups[best].append(region)
        else:
            groups.append([region])
    # a region that came first may have founded an object of its own although a later one,
    # which overlaps both, shows that they are the same: try every object against the larger ones
    groups.sort(key=lambda g: -sum(r.area for r in g))
    kept: list[list[ChangedRegion]] = []
    for group in groups:
        scores = [similarity(k, group, config) for k in kept]
        best = int(np.argmax(scores)) if scores else -1
        if best >= 0 and scores[best] > least:
            kept[best] = kept[best] + group
        else:
            kept.append(group)
    return kept


def _joined(
    groups: list[list[ChangedRegion]],
    geometry: Geometry,
    proposals: Sequence[Regions],
    config: ObjectConfig,
) -> list[list[ChangedRegion]]:
    parts = _parts(groups)
    found = _borders(parts, geometry, proposals, config)
    sets = joined(parts, found, config.join_share, config.join_length, config.enclosed)
    return [[r for number in sorted(members) for r in groups[number]] for members in sets]


def _with_weak_parts(
    groups: list[list[ChangedRegion]],
    weak: Sequence[ChangedRegion],
    geometry: Geometry,
    proposals: Sequence[Regions],
    config: ObjectConfig,
) -> list[list[ChangedRegion]]:
    parts = _parts(groups)
    found = _borders(parts, geometry, proposals, config)
    owner = adopted(parts, _parts([weak]), found, config.join_share, config.join_length)
    grown = [list(group) for group in groups]
    for region in weak:
        number = owner.get((region.view, region.label))
        if number is not None:
            grown[number].append(region)
    return grown


def _parts(groups: Sequence[Sequence[ChangedRegion]]) -> list[Part]:
    return [Part(number, r.view, r.label, r.area) for number, g in enumerate(groups) for r in g]


def _borders(
    parts: Sequence[Part], geometry: Geometry, proposals: Sequence[Regions], config: ObjectConfig
) -> dict[int, dict[tuple[int, int], Border]]:
    return {
        k: borders(proposals[k].labels, geometry.views[k].depth, config.depth_step)
        for k in {p.view for p in parts}
    }


def _visible(
    group: Sequence[ChangedRegion], geometry: Geometry, config: ObjectConfig
) -> list[ChangedRegion]:
    """Without the views in which the object is too small to count."""
    areas: dict[int, int] = {}
    for region in group:
        areas[region.view] = areas.get(region.view, 0) + region.area

    def least(view: View) -> float:
        return config.min_area * (max(view.shape) / 518) ** 2

    return [r for r in group if areas[r.view] >= least(geometry.views[r.view])]


def _is_convincing(
    group: list[ChangedRegion], geometry: Geometry, threshold: float, config: ObjectConfig
) -> bool:
    """Whether enough views show the object, and clearly enough for their number."""
    if len(geometry.views) <= 2:
        return True
    views = len({r.view for r in group})
    areas = [r.area for r in group]
    if np.average([r.terms.feature for r in group], weights=areas) < config.min_feature:
        return False
    score = np.average([r.score for r in group], weights=areas)
    if score < threshold * (1 + config.lone_margin / views**2):
        return False
    by_pair = pair_scores(group)
    sizes = np.bincount([r.view for r in group], weights=areas)
    weights = [sizes[view] for view, _ in by_pair]  # more pixels, a firmer comparison
    agreeing = [s > threshold for s in by_pair.values()]
    if agreeing and np.average(agreeing, weights=weights) < config.min_agreement:
        return False
    return bool(_support(group, geometry, config) >= config.min_support)


def _support(group: list[ChangedRegion], geometry: Geometry, config: ObjectConfig) -> float:
    """Views that show the object / views of its capture that could show it."""
    points = np.concatenate([every(r.points, 200) for r in group])
    seen = {r.view for r in group}
    video = geometry.views[group[0].view].video
    could = 0
    for k, view in enumerate(geometry.views):
        if view.video != video:
            continue
        if k in seen:
            could += 1
            continue
        xy, z = project(points, view.intrinsics, view.cam_from_world)
        depth = sample(view.depth, xy[None], nearest=True)[0]
        same = np.abs(np.nan_to_num(depth, nan=np.inf) - z) < config.merge_radius
        could += int(len(points) > 0 and same.mean() > 0.5)
    return len(seen) / max(could, 1)


def _mean_descriptor(regions: Sequence[ChangedRegion]) -> Float[np.ndarray, "c"]:
    weights = np.array([float(r.area) for r in regions])
    mean = weights @ np.stack([r.descriptor for r in regions])
    return mean / max(float(np.linalg.norm(mean)), 1e-8)


def _thinned(regions: Sequence[ChangedRegion], config: ObjectConfig) -> list[ChangedRegion]:
    return [replace(r, points=every(r.points, config.max_points)) for r in regions]
