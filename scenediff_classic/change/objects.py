"""From changed regions to changed objects with one identity over all views (paper Sec. 4.3)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from scenediff_classic.cameras import project, sample, unproject
from scenediff_classic.change.contact import Part, borders, joined
from scenediff_classic.change.scoring import Scores
from scenediff_classic.types import VIDEOS, Geometry, Regions, TermScores, Video, View


@dataclass(frozen=True)
class ObjectConfig:
    """How regions become objects; lengths in normalised units."""

    min_area: float = 100.0
    """Smallest object in a view, in pixels of a picture with long side 518."""
    merge_radius: float = 2 / 200
    """Two voxels: the distance within which points count as shared (sigma_geo)."""
    min_overlap: float = 0.5
    """Least S_geo for a merge, whatever S_feat says."""
    join_share: float = 0.7
    """Changed regions whose common border is smooth in depth to this share are one thing; 1.01
    turns joining off, as in the paper, whose regions are whole objects."""
    join_length: float = 0.2
    """Smooth border needed to join, relative to the smaller region's size."""
    depth_step: float = 0.03
    """Relative depth difference of neighbouring pixels that separates things."""
    min_support: float = 0.3
    """Share of the views that must show an object, among those of its capture that could."""
    lone_margin: float = 0.5
    """How far above the threshold an object's mean score must be if a single view shows it,
    relative to the threshold; divided by the square of the number of views that show it. One look
    proves less than ten. Not used for two single photos."""
    min_feature: float = 0.08
    """Least mean E_feat of an object: where both captures look the same, a depth difference is
    an error of depth. 0 turns this off, as in the paper. Not used for two single photos."""
    min_part: float = 0.25
    """Share of a region's points that must hang together to count as part of its place: a region
    that bleeds onto another thing must not tie the two together. 0 turns this off."""
    max_points: int = 1000
    """Points kept per region for the overlap test."""


@dataclass(frozen=True)
class ChangedRegion:
    """A changed region as one view sees it."""

    view: int
    """Position in `Geometry.views`."""
    label: int
    """Label in that view's regions."""
    mask: Bool[np.ndarray, "h w"]
    score: float
    terms: TermScores
    descriptor: Float32[np.ndarray, "c"]
    points: Float64[np.ndarray, "n 3"]
    """World points, normalised units."""
    comparisons: tuple[tuple[int, float], ...] = ()
    """(position of a view of the other capture, score when compared with that one alone)."""

    @property
    def area(self) -> int:
        """Number of pixels."""
        return int(np.count_nonzero(self.mask))


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


def changed_regions(
    geometry: Geometry,
    regions: Sequence[Regions],
    scores: Scores,
    threshold: float,
    config: ObjectConfig,
) -> list[ChangedRegion]:
    """Regions above the threshold in every view (not yet cleaned of tiny ones)."""
    found = []
    for k, (view, proposal) in enumerate(zip(geometry.views, regions, strict=True)):
        scored = scores.regions[k]
        compared = [(b, score) for (a, b), score in scores.comparisons.items() if a == k]
        changed = np.flatnonzero(np.nan_to_num(scored.total, nan=-np.inf) > threshold)
        if len(changed) == 0:
            continue
        points = unproject(view)
        for label in changed:
            mask = (proposal.labels == label) & ~view.ignore
            if not mask.any():
                continue
            terms = (scored.geometry[label], scored.feature[label], scored.region[label])
            found.append(
                ChangedRegion(
                    view=k,
                    label=int(label),
                    mask=mask,
                    score=float(scored.total[label]),
                    terms=TermScores(*(float(np.nan_to_num(t)) for t in terms)),
                    descriptor=scored.descriptors[label],
                    points=main_parts(_cloud(points[mask]), config),
                    comparisons=tuple(
                        (b, float(s[label])) for b, s in compared if np.isfinite(s[label])
                    ),
                )
            )
    return found


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
        own = [r for r in regions if geometry.views[r.view].video == video]
        own.sort(key=lambda r: (-r.score, -r.area, float(r.points.sum())))
        if len(geometry.views) > 2:
            groups = _associated(own, merge_threshold, config)
        else:
            groups = [[r] for r in own]
        groups = _joined(groups, geometry, proposals, config)
        groups = [_visible(g, geometry, config) for g in groups]
        for group in groups:
            if group and _is_convincing(group, geometry, threshold, config):
                objects.append(SceneObject(video, tuple(_thinned(group, config))))
    return objects


def similarity(
    group: Sequence[ChangedRegion], others: Sequence[ChangedRegion], config: ObjectConfig
) -> float:
    """S of eq. 5 between two sets of regions: descriptor cosine + share of `others` near `group`.

    -inf if their points share too little to be one thing.
    """
    points = np.concatenate([r.points for r in group])
    new = np.concatenate([_every(r.points, config.max_points // 4) for r in others])
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
    parts = [Part(number, r.view, r.label, r.area) for number, g in enumerate(groups) for r in g]
    found = {
        k: borders(proposals[k].labels, geometry.views[k].depth, config.depth_step)
        for k in {p.view for p in parts}
    }
    sets = joined(parts, found, config.join_share, config.join_length)
    return [[r for number in sorted(members) for r in groups[number]] for members in sets]


def _visible(
    group: list[ChangedRegion], geometry: Geometry, config: ObjectConfig
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
    return bool(_support(group, geometry, config) >= config.min_support)


def _support(group: list[ChangedRegion], geometry: Geometry, config: ObjectConfig) -> float:
    """Views that show the object / views of its capture that could show it."""
    points = np.concatenate([_every(r.points, 200) for r in group])
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


def _cloud(points: np.ndarray) -> Float64[np.ndarray, "n 3"]:
    return points[np.isfinite(points).all(axis=1)].astype(np.float64)


def main_parts(
    points: Float64[np.ndarray, "n 3"], config: ObjectConfig
) -> Float64[np.ndarray, "m 3"]:
    """At most `max_points` of the points, without small groups that lie apart from the others."""
    points = _every(points, config.max_points)
    if len(points) < 2 or config.min_part <= 0:
        return points
    pairs = KDTree(points).query_pairs(config.merge_radius, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    _, part = connected_components(links, directed=False)
    sizes = np.bincount(part)
    enough = min(config.min_part * len(points), sizes.max())
    return points[sizes[part] >= enough]


def _every(points: np.ndarray, most: int) -> np.ndarray:
    return points[:: max(-(-len(points) // most), 1)]


def _thinned(regions: Sequence[ChangedRegion], config: ObjectConfig) -> list[ChangedRegion]:
    return [replace(r, points=_every(r.points, config.max_points)) for r in regions]
