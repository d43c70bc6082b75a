"""Object-like regions: superpixels merged over a region-adjacency graph.

Colour alone cuts objects into their printed parts, depth alone glues them to what they stand on;
the merging order weighs both, and stops where every remaining border is strong.
"""

import heapq
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float32, Int32
from scipy.ndimage import distance_transform_edt
from skimage.segmentation import felzenszwalb, relabel_sequential

from scenediff_classic.cameras import unproject
from scenediff_classic.colour import lab_colours
from scenediff_classic.types import Regions, View


@dataclass(frozen=True)
class BoundaryMergingRegions:
    """Felzenszwalb superpixels on colour and depth, merged while their border is weak.

    The border between two regions is as strong as their colours differ, plus the depth step
    across it, plus its concavity: parts of one thing meet at convex edges, a thing and its support
    at concave ones (the observation behind locally convex connected patches, Stein et al. 2014).
    """

    scale: float = 25.0
    """Felzenszwalb's scale, for a 512-pixel-wide picture: larger = larger superpixels."""
    min_area: float = 100.0
    """Regions smaller than this join a neighbour; pixels of a picture with long side 518."""
    depth_weight: float = 8.0
    """Weight of log-depth against colour when superpixels form."""
    step_weight: float = 6.0
    """Strength of a border per unit of relative depth step."""
    concavity_weight: float = 0.5
    """Strength of a border per unit of sine of the concave angle."""
    colour_weight: float = 1.0
    """Strength of a border per unit of mean-colour distance."""
    edge_weight: float = 0.5
    """Strength of a border per unit of colour contrast right across it."""
    stop: float = 0.35
    """Border strength at which merging ends."""

    def __call__(self, view: View) -> Regions:
        """Regions cover the whole picture."""
        return self.within(view, np.full(view.shape, -1, np.int32), 0)

    def within(self, view: View, parts: Int32[np.ndarray, "h w"], whole: int) -> Regions:
        """Regions that keep to parts of the picture which are known to be different things.

        Parameters
        ----------
        parts : int array (h, w)
            Which part a pixel belongs to; -1 = unknown. Superpixels go with the majority of
            their pixels, so that outlines come from the picture.
        whole : int
            Parts below this number are one region each; the others are merged by their borders.
        """
        lab = lab_colours(view.image) * np.array([1.5, 2.5, 2.5], np.float32)
        depth = filled_depth(view)
        shrink = max(view.shape) / 512
        stack = np.dstack([lab, np.log(depth) * self.depth_weight]).astype(np.float64)
        with warnings.catch_warnings():  # four channels are what we mean
            warnings.simplefilter("ignore", RuntimeWarning)
            superpixels = felzenszwalb(
                stack,
                scale=self.scale * shrink**2,
                sigma=0.6,
                min_size=max(int(self.min_area * (max(view.shape) / 518) ** 2 / 2.5), 4),
                channel_axis=-1,
            )
        superpixels = superpixels.astype(np.int32)
        part = _majorities(superpixels, parts)
        labels = self._merge(_Graph(superpixels, lab, depth, view, self), part, whole)[superpixels]
        labels = relabel_sequential(labels + 1)[0].astype(np.int32) - 1
        return Regions(labels, int(labels.max()) + 1)

    def _merge(self, graph: "_Graph", part: list[int], whole: int) -> Int32[np.ndarray, "n"]:
        """Owner of each superpixel."""
        first: dict[int, int] = {}
        for a, known in enumerate(part):
            if 0 <= known < whole and first.setdefault(known, a) != a:
                graph.absorb(first[known], a)

        def strength(a: int, b: int) -> float:
            apart = part[a] != part[b] and part[a] >= 0 and part[b] >= 0
            return math.inf if apart else graph.strength(a, b)

        heap = [(strength(a, b), a, b) for a in graph.borders for b in graph.borders[a] if a < b]
        heapq.heapify(heap)
        while heap:
            value, a, b = heapq.heappop(heap)
            if a not in graph.borders or b not in graph.borders[a]:
                continue  # one of the two was merged away meanwhile
            if value != strength(a, b):
                continue  # outdated: the up-to-date entry is in the heap too
            if value > self.stop and min(graph.size[a], graph.size[b]) >= graph.small:
                continue
            if part[a] < 0 or (part[b] >= 0 and graph.size[b] > graph.size[a]):
                part[a] = part[b]
            graph.absorb(a, b)
            for c in graph.borders[a]:
                low, high = min(a, c), max(a, c)
                heapq.heappush(heap, (strength(low, high), low, high))
        return graph.owner


class _Graph:
    """Region statistics and borders; `absorb` keeps them up to date."""

    def __init__(self, labels, lab, depth, view: View, options: BoundaryMergingRegions) -> None:
        self.options = options
        self.small = options.min_area * (max(view.shape) / 518) ** 2
        count = int(labels.max()) + 1
        self.owner = np.arange(count, dtype=np.int32)
        self.members = {a: [a] for a in range(count)}
        flat = labels.ravel()
        sizes = np.bincount(flat, minlength=count).astype(float)
        self.size = sizes.tolist()
        normals, points = _normals(view, depth)
        self.colour = _means(flat, lab, sizes)
        self.normal = [_unit(n) for n in _means(flat, normals, sizes)]
        self.point = _means(flat, points, sizes)
        self.borders: dict[int, dict[int, tuple[float, float, float]]] = {
            a: {} for a in range(count)
        }
        """Per pair of neighbours: border length, and sums of contrast and depth step along it."""
        for axis in (0, 1):
            self._add_borders(labels, lab, np.log(depth), axis)

    def _add_borders(self, labels, lab, log_depth, axis: int) -> None:
        head = [slice(None, -1) if k == axis else slice(None) for k in (0, 1)]
        tail = [slice(1, None) if k == axis else slice(None) for k in (0, 1)]
        a, b = labels[tuple(head)], labels[tuple(tail)]
        cut = a != b
        contrast = np.linalg.norm(lab[tuple(head)] - lab[tuple(tail)], axis=-1)[cut]
        # what a slanted surface would step by anyway is no step: second difference of log depth
        gradient = np.gradient(cv2.GaussianBlur(log_depth, (0, 0), 2), axis=axis)
        step = np.abs(log_depth[tuple(tail)] - log_depth[tuple(head)])[cut]
        slope = np.minimum(np.abs(gradient[tuple(head)]), np.abs(gradient[tuple(tail)]))[cut]
        step = np.clip(step - slope, 0, 0.5)
        low, high = np.minimum(a, b)[cut], np.maximum(a, b)[cut]
        order = np.lexsort((high, low))
        pairs = np.c_[low, high][order]
        starts = np.r_[0, np.flatnonzero(np.any(np.diff(pairs, axis=0), axis=1)) + 1]
        if len(pairs) == 0:
            return
        sums = np.add.reduceat(np.c_[np.ones(len(pairs)), contrast[order], step[order]], starts)
        for (first, second), values in zip(pairs[starts].tolist(), sums.tolist(), strict=True):
            self._lengthen(first, second, values)

    def _lengthen(self, a: int, b: int, values: Sequence[float]) -> None:
        old = self.borders[a].get(b, (0.0, 0.0, 0.0))
        total = old[0] + values[0], old[1] + values[1], old[2] + values[2]
        self.borders[a][b] = self.borders[b][a] = total

    def strength(self, a: int, b: int) -> float:
        """How strongly the border between two neighbouring regions separates them."""
        o = self.options
        length, contrast, step = self.borders[a][b]
        colour = math.dist(self.colour[a], self.colour[b])
        normal_a, normal_b = self.normal[a], self.normal[b]
        cosine = min(max(_dot(normal_a, normal_b), -1.0), 1.0)
        # concave where the normals lean towards each other along the line between the centres
        apart = [x - y for x, y in zip(self.point[a], self.point[b], strict=True)]
        bend = _dot(apart, normal_a) - _dot(apart, normal_b)
        concave = math.sqrt(1 - cosine * cosine) if bend < 0 else 0.0
        return (
            o.colour_weight * colour
            + o.edge_weight * contrast / length
            + o.step_weight * step / length
            + o.concavity_weight * concave
        )

    def absorb(self, a: int, b: int) -> None:
        """Merge region `b` into `a`."""
        share = self.size[b] / (self.size[a] + self.size[b])
        self.size[a] += self.size[b]
        for mean in (self.colour, self.point, self.normal):
            mean[a] = [(1 - share) * x + share * y for x, y in zip(mean[a], mean[b], strict=True)]
        self.normal[a] = _unit(self.normal[a])
        self.owner[self.members[b]] = a
        self.members[a] += self.members.pop(b)
        for c, values in self.borders.pop(b).items():
            del self.borders[c][b]
            if c != a:
                self._lengthen(a, c, values)


def filled_depth(view: View) -> Float32[np.ndarray, "h w"]:
    """Depth with unknown pixels taken from the nearest known one (1 everywhere if none is)."""
    known = np.isfinite(view.depth) & (view.depth > 0)
    if not known.any():
        return np.ones(view.shape, np.float32)
    nearest = np.empty((2, *view.shape), np.int32)
    distance_transform_edt(~known, return_distances=False, return_indices=True, indices=nearest)
    rows, columns = nearest
    return cv2.medianBlur(view.depth[rows, columns], 5)


def _normals(view: View, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    smooth = cv2.bilateralFilter(np.log(depth), 9, 0.02, 3)
    points = unproject(replace(view, depth=np.exp(smooth)))
    dx = np.gradient(points, axis=1)
    dy = np.gradient(points, axis=0)
    normals = np.cross(dy, dx)  # towards the camera for image axes right and down
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return normals / np.maximum(length, 1e-12), points


def _majorities(labels: Int32[np.ndarray, "h w"], parts: Int32[np.ndarray, "h w"]) -> list[int]:
    """The part that holds more than half of each label's pixels; -1 if none does."""
    count = int(parts.max()) + 2  # the first column counts the unknown
    keys = labels.ravel().astype(np.int64) * count + parts.ravel() + 1
    votes = np.bincount(keys, minlength=(int(labels.max()) + 1) * count).reshape(-1, count)
    best = np.argmax(votes, axis=1)
    return np.where(votes.max(axis=1) > votes.sum(axis=1) / 2, best - 1, -1).tolist()


def _means(labels: np.ndarray, values: np.ndarray, sizes: np.ndarray) -> list[list[float]]:
    columns = values.reshape(len(labels), -1)
    sums = [np.bincount(labels, c, minlength=len(sizes)) for c in columns.T]
    return (np.stack(sums, axis=-1) / np.maximum(sizes, 1)[:, None]).tolist()


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _unit(vector: Sequence[float]) -> list[float]:
    length = max(math.sqrt(_dot(vector, vector)), 1e-12)
    return [x / length for x in vector]
