"""Regions whose score says that they changed, and the points that stand for their place."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from scenediff_classic.cameras import unproject
from scenediff_classic.change.scoring import Scores
from scenediff_classic.types import Geometry, Regions, TermScores


@dataclass(frozen=True)
class ObjectConfig:
    """How regions become objects; lengths in normalised units."""

    min_area: float = 100.0
    """Smallest object in a view, in pixels of a picture with long side 518."""
    merge_radius: float = 2 / 200
    """Two voxels: the distance within which points count as shared (sigma_geo)."""
    min_overlap: float = 0.6
    """Least S_geo for a merge, whatever S_feat says."""
    join_share: float = 0.7
    """Changed regions whose common border is smooth in depth to this share are one thing; 1.01
    turns joining off, as in the paper, whose regions are whole objects."""
    join_length: float = 0.2
    """Smooth border needed to join, relative to the smaller region's size."""
    enclosed: float = 2.0
    """Border, relative to the smaller one's size, from which on one changed thing lies within
    another and is part of it, whatever depth does there: half the outline of a square. Must be so
    in most views. A large value turns this off, as in the paper, whose regions are whole."""
    weak: float = 0.7
    """Score, relative to the threshold, from which on a region is part of the changed object that
    it touches without a depth step, unless it is larger; 1 turns this off, as in the paper, whose
    regions are whole objects."""
    depth_step: float = 0.03
    """Relative depth difference of neighbouring pixels that separates things."""
    min_support: float = 0.5
    """Share of the views that must show an object, among those of its capture that could."""
    min_agreement: float = 0.75
    """Share of the comparisons of two views that must find an object changed each by itself, among
    those that could see its place, weighted by its area in the view. 0 turns this off, as in the
    paper. Not used for two single photos."""
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
        least = threshold * min(config.weak, 1)
        changed = np.flatnonzero(np.nan_to_num(scored.total, nan=-np.inf) > least)
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


def pair_scores(regions: Sequence[ChangedRegion]) -> dict[tuple[int, int], float]:
    """Score of an object's regions in each comparison of (a view that shows it, one of the other
    capture); several regions of a view are averaged by area."""
    parts: dict[tuple[int, int], list[tuple[float, int]]] = {}
    for region in regions:
        for other, score in region.comparisons:
            parts.setdefault((region.view, other), []).append((score, region.area))
    return {
        pair: float(np.average([s for s, _ in seen], weights=[area for _, area in seen]))
        for pair, seen in parts.items()
    }


def main_parts(
    points: Float64[np.ndarray, "n 3"], config: ObjectConfig
) -> Float64[np.ndarray, "m 3"]:
    """At most `max_points` of the points, without small groups that lie apart from the others."""
    points = every(points, config.max_points)
    if len(points) < 2 or config.min_part <= 0:
        return points
    pairs = KDTree(points).query_pairs(config.merge_radius, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    _, part = connected_components(links, directed=False)
    sizes = np.bincount(part)
    enough = min(config.min_part * len(points), sizes.max())
    return points[sizes[part] >= enough]


def every(points: np.ndarray, most: int) -> np.ndarray:
    return points[:: max(-(-len(points) // most), 1)]


def _cloud(points: np.ndarray) -> Float64[np.ndarray, "n 3"]:
    return points[np.isfinite(points).all(axis=1)].astype(np.float64)
