"""Whole things: what stands before large planes, cut where depth jumps.

A printed box is one thing although its colours differ, and a white cup on a white table is
another although they do not: depth says so. Outlines still come from the picture, and flat things
(a rug, a poster) from its colours, for depth does not tell them from what they lie on.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int32
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from scenediff_classic.regions.boundary_merging import BoundaryMergingRegions
from scenediff_classic.regions.support_planes import (
    SupportConfig,
    Supports,
    camera_points,
    support_planes,
)
from scenediff_classic.types import Regions, View

_HULL_POINTS = 300


@dataclass(frozen=True)
class ThingsOnSupportsRegions:
    """Things as depth shows them first, colour-based regions for all the rest.

    Support planes are taken away; what is left falls apart where depth jumps. Pieces above the
    same spot of a support are one thing again: a lamp's shade and foot, a bowl and its fruit.
    """

    supports: SupportConfig = field(default_factory=SupportConfig)
    step: float = 0.015
    """Relative depth step between neighbouring pixels, beyond the surface's slope, that cuts."""
    min_area: float = 100.0
    """Smallest thing; pixels of a picture with long side 518."""
    most_share: float = 0.15
    """Largest thing, as a share of the picture: what is larger is left to the colours."""
    reach: int = 3
    """Pieces this near each other in the picture may be one thing, in pixels."""
    over: float = 0.5
    """Share of a piece's footprint on another one's that makes them one thing."""
    compact: float = 0.6
    """Least share of a thing's area in its convex hull. What fills less, such as a shelf with all
    that stands on it, is cut further by its colours."""
    rest: BoundaryMergingRegions = field(default_factory=BoundaryMergingRegions)

    def __call__(self, view: View) -> Regions:
        """Regions cover the whole picture."""
        supports = support_planes(view, self.supports)
        things = self.things(view, supports)
        count = int(things.max()) + 1
        whole = np.array([_solidity(things == k) >= self.compact for k in range(count)], bool)
        order = np.argsort(~whole, kind="stable")  # whole ones first
        number = np.append(np.argsort(order), -1)
        parts = np.where(supports.labels >= 0, supports.labels + count, number[things])
        return self.rest.within(view, parts.astype(np.int32), int(whole.sum()))

    def things(self, view: View, supports: Supports) -> Int32[np.ndarray, "h w"]:
        """Things by number; -1 for supports, unknown depth and what is too small or too large."""
        free = np.isfinite(view.depth) & (view.depth > 0) & (supports.labels < 0)
        pieces = self._pieces(view, free)
        sizes = np.bincount(pieces[free])
        least = self.min_area / 4 * (max(view.shape) / 518) ** 2
        fits = (sizes >= least) & (sizes < self.most_share * free.size)
        pieces = _renumbered(pieces, fits)
        if supports.up is not None and fits.any():
            pieces = self._joined(view, pieces, supports)
        sizes = np.bincount(pieces[pieces >= 0])
        return _renumbered(pieces, (sizes >= 4 * least) & (sizes < self.most_share * free.size))

    def _pieces(self, view: View, free: Bool[np.ndarray, "h w"]) -> Int32[np.ndarray, "h w"]:
        """Connected pixels without a depth step between neighbours; -1 where not `free`."""
        number = np.full(view.shape, -1, np.int32)
        number[free] = np.arange(np.count_nonzero(free))
        log_depth = np.log(np.where(free, view.depth, np.nan))
        links = []
        for ids, values in ((number, log_depth), (number.T, log_depth.T)):
            change = np.diff(values, axis=1)
            padded = np.pad(change, ((0, 0), (1, 1)), constant_values=np.nan)
            gap = np.abs(change)  # what the surface's slope on either side explains is no step
            for slope in (padded[:, :-2], padded[:, 2:]):
                gap = np.fmin(gap, np.abs(change - slope))
            smooth = gap < self.step
            links.append(np.stack([ids[:, :-1][smooth], ids[:, 1:][smooth]]))
        first, second = np.concatenate(links, axis=1)
        count = np.count_nonzero(free)
        graph = coo_matrix((np.ones(len(first), bool), (first, second)), shape=(count, count))
        number[free] = connected_components(graph, directed=False)[1]
        return number

    def _joined(
        self, view: View, pieces: Int32[np.ndarray, "h w"], supports: Supports
    ) -> Int32[np.ndarray, "h w"]:
        """Pieces above the same spot become one, if they are on the same side of all supports."""
        assert supports.up is not None
        points = camera_points(view)
        side = np.linalg.svd(supports.up[None])[2][1:]  # two directions along the support
        clouds = [points[pieces == k] for k in range(int(pieces.max()) + 1)]
        clouds = [c[:: max(len(c) // _HULL_POINTS, 1)] for c in clouds]
        footprints = [(c @ side.T).astype(np.float32) for c in clouds]
        above = [supports.above(c) for c in clouds]
        links = [
            (a, b)
            for a, b in _neighbours(pieces, self.reach)
            if np.array_equal(above[a], above[b])
            and max(
                _share_inside(footprints[a], footprints[b]),
                _share_inside(footprints[b], footprints[a]),
            )
            > self.over
        ]
        a, b = np.array(links, int).reshape(-1, 2).T
        graph = coo_matrix((np.ones(len(a), bool), (a, b)), shape=(len(clouds), len(clouds)))
        owner = connected_components(graph, directed=False)[1].astype(np.int32)
        return np.where(pieces >= 0, owner[pieces], -1).astype(np.int32)


def _renumbered(
    labels: Int32[np.ndarray, "h w"], keep: Bool[np.ndarray, "n"]
) -> Int32[np.ndarray, "h w"]:
    """Kept labels without gaps; -1 elsewhere."""
    new = np.append(np.where(keep, np.cumsum(keep) - 1, -1), -1).astype(np.int32)
    return new[labels]


def _neighbours(labels: Int32[np.ndarray, "h w"], reach: int) -> list[tuple[int, int]]:
    """Pairs of labels that come as near as `reach` pixels, the smaller first, in order."""
    distance, nearest = np.empty(labels.shape), np.empty((2, *labels.shape), np.int32)
    distance_transform_edt(labels < 0, return_indices=True, distances=distance, indices=nearest)
    grown = np.where(distance <= reach / 2, labels[nearest[0], nearest[1]], -1)
    pairs = []
    for a, b in ((grown[:, :-1], grown[:, 1:]), (grown[:-1], grown[1:])):
        touch = (a != b) & (a >= 0) & (b >= 0)
        pairs.append(np.stack([np.minimum(a, b)[touch], np.maximum(a, b)[touch]], axis=1))
    return [(a, b) for a, b in np.unique(np.concatenate(pairs), axis=0).tolist()]


def _solidity(mask: Bool[np.ndarray, "h w"]) -> float:
    """Share of the area in that of its convex hull, all pixels with their corners."""
    rows, columns = np.nonzero(mask)
    corners = np.concatenate([np.c_[columns + i, rows + j] for i in (0, 1) for j in (0, 1)])
    return len(rows) / cv2.contourArea(cv2.convexHull(corners.astype(np.int32)))


def _share_inside(points: Float32[np.ndarray, "n 2"], others: Float32[np.ndarray, "m 2"]) -> float:
    """Share of the points inside the convex hull of others."""
    hull = cv2.convexHull(others)[:, 0]
    along = np.roll(hull, -1, axis=0) - hull
    offset = points[:, None] - hull
    turn = along[:, 0] * offset[..., 1] - along[:, 1] * offset[..., 0]
    return float(np.mean(np.all(turn >= 0, axis=1) | np.all(turn <= 0, axis=1)))
