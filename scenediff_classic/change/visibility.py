"""What one view can say about another: reprojection, occlusion, co-visibility (Sec. 4.1-4.2)."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, Int8

from scenediff_classic.cameras import project, sample, unproject
from scenediff_classic.change.kernels import reproject_pixels
from scenediff_classic.types import Geometry, View


@dataclass(frozen=True)
class VisibilityConfig:
    """Which pixels may be compared across views; lengths in normalised units."""

    occlusion: float = -0.02
    """The paper's tau_occ: a pixel this far behind the other view's surface is occluded."""
    min_confidence: float = 0.1
    depth_edge: float = 0.03
    """Relative depth change within 3x3 pixels that makes a pixel a depth edge."""
    agreement: float = 0.02
    """Depth difference up to which two views see the same surface (for co-visibility)."""
    pair_covisibility: float = 0.5
    """Views at least this co-visible are compared; each view's best partner always is."""


@dataclass(frozen=True)
class Reprojection:
    """Pixels of a source view, seen from a target view."""

    xy: Float32[np.ndarray, "h w 2"]
    """Position in the target picture; NaN where depth is unknown or behind the camera."""
    gap: Float32[np.ndarray, "h w"]
    """E_geom, eq. 1: target depth minus reprojected depth; NaN where either is unknown."""
    visible: Bool[np.ndarray, "h w"]
    """M of the paper: comparable and not occluded."""
    measured: Bool[np.ndarray, "h w"]
    """True where both depths were measured, so that `gap` is evidence and not a guess."""


def usable_pixels(view: View, config: VisibilityConfig) -> Bool[np.ndarray, "h w"]:
    """Pixels with a depth worth comparing: known, trusted, static, not on a depth edge."""
    trusted = ~view.measured | (view.confidence > config.min_confidence)
    known = np.isfinite(view.depth) & trusted & ~view.ignore
    return known & ~depth_edges(view.depth, config.depth_edge)


def depth_edges(depth: Float32[np.ndarray, "h w"], relative: float) -> Bool[np.ndarray, "h w"]:
    """True where depth varies by more than `relative` within 3x3 pixels (unknowns left out)."""
    kernel = np.ones((3, 3), np.uint8)
    unknown = ~np.isfinite(depth)
    high = cv2.dilate(np.where(unknown, -np.inf, depth).astype(np.float32), kernel)
    low = cv2.erode(np.where(unknown, np.inf, depth).astype(np.float32), kernel)
    step = np.where(unknown, 0, high) - np.where(unknown, 0, low)
    return step > relative * np.where(unknown, 1, depth)


@dataclass(frozen=True)
class Comparable:
    """A view prepared for comparison with many others."""

    view: View
    points: Float32[np.ndarray, "h w 3"]
    """World point of every pixel."""
    fit: Int8[np.ndarray, "h w"]
    """0 = not comparable, 1 = guessed depth, 2 = measured depth."""

    @staticmethod
    def of(view: View, config: VisibilityConfig) -> "Comparable":
        """Work out what does not depend on the other view."""
        usable = usable_pixels(view, config)
        fit = np.where(usable, np.where(view.measured, 2, 1), 0).astype(np.int8)
        return Comparable(view, unproject(view), fit)


def reproject(source: Comparable, target: Comparable, config: VisibilityConfig) -> Reprojection:
    """Carry every pixel of `source` into `target` and compare depths there."""
    camera = target.view.cam_from_world
    xy, gap, state = reproject_pixels(
        source.points, source.fit, target.view.intrinsics @ camera[:3], camera[2],
        target.view.depth, target.fit, config.occlusion,
    )  # fmt: skip
    return Reprojection(xy, gap, state > 0, state == 2)


def covisibility(geometry: Geometry, config: VisibilityConfig) -> Float64[np.ndarray, "b a"]:
    """Fraction of mutually visible pixels, mean of both directions, for every (before, after) pair.

    A pixel is mutually visible when it lands inside the other picture, in front of the camera, at
    the depth seen there. Its unknown-depth pixels count against a view only if nothing is known.
    """
    before, after = ([_Thinned.of(v) for v in geometry.of(video)] for video in ("before", "after"))
    out = np.zeros((len(before), len(after)))
    for i, first in enumerate(before):
        for j, second in enumerate(after):
            there = first.fraction_seen_by(second, config.agreement)
            back = second.fraction_seen_by(first, config.agreement)
            out[i, j] = (there + back) / 2
    return out


def pair_views(geometry: Geometry, config: VisibilityConfig) -> tuple[tuple[int, int], ...]:
    """Positions in `geometry.views` of the (before, after) views to compare (paper Sec. 4.1).

    Pairs above the co-visibility threshold, and the best partner of every view of either capture;
    pairs that share nothing are never compared.
    """
    position = {v.key: k for k, v in enumerate(geometry.views)}
    before = [position[v.key] for v in geometry.of("before")]
    after = [position[v.key] for v in geometry.of("after")]
    if not before or not after:
        return ()
    shared = covisibility(geometry, config)
    chosen = shared > config.pair_covisibility
    chosen[np.arange(len(before)), shared.argmax(axis=1)] = True
    chosen[shared.argmax(axis=0), np.arange(len(after))] = True
    chosen &= shared > 0
    return tuple((before[i], after[j]) for i, j in np.argwhere(chosen))


@dataclass(frozen=True)
class _Thinned:
    """Every few pixels of a view, ready to be projected many times."""

    view: View
    points: np.ndarray

    @staticmethod
    def of(view: View) -> "_Thinned":
        step = max(max(view.shape) // 64, 1)
        points = unproject(view)[step // 2 :: step, step // 2 :: step].reshape(-1, 3)
        return _Thinned(view, points[np.isfinite(points).all(axis=1)].astype(np.float64))

    def fraction_seen_by(self, other: "_Thinned", agreement: float) -> float:
        if len(self.points) == 0:
            return 0.0
        xy, z = project(self.points, other.view.intrinsics, other.view.cam_from_world)
        depth = sample(other.view.depth, xy[None], nearest=True)[0]
        return float(np.mean(np.abs(np.nan_to_num(depth, nan=np.inf) - z) < agreement))
