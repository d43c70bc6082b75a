"""Depth of one view by a plane sweep with semi-global aggregation.

Sources are warped by planes of constant inverse depth (R. Collins, A space-sweep approach to true
multi-image matching, CVPR 1996); what the planes cost at each pixel is summed up along straight
paths (H. Hirschmueller, Stereo processing by semiglobal matching and mutual information, PAMI
2008); the slopes of the winning planes follow from their neighbours.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from scenediff_classic.geometry.stereo import sweep_kernels as kernels
from scenediff_classic.geometry.stereo.depth_confidence import ConfidenceWeights
from scenediff_classic.geometry.stereo.depth_map import DepthMap
from scenediff_classic.geometry.stereo.patchmatch import PatchMatch
from scenediff_classic.geometry.stereo.pyramid import Pictures, pictures_at
from scenediff_classic.geometry.stereo.smoothing import smooth_planes
from scenediff_classic.geometry.stereo.view_selection import inverse_depth_range
from scenediff_classic.types import View

DIRECTIONS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1), (1, -1), (-1, 1))
"""(down, right) steps of the paths that costs are summed up along."""

COARSE = 4
"""The range of depth is first narrowed in pictures of 1 / `COARSE` of the size,"""

COARSE_SPACING_PX = 0.5
"""with planes that are so many of its pixels apart,"""

COARSE_MIN_SIDE = 32
"""unless they would be smaller than this."""

COARSE_MARGIN = 1.2
"""Factor by which the narrowed range is widened at either end."""

SMOOTH_RADIUS = 6
SMOOTH_STRIDE = 3
DOUBT = 0.1
"""Weight, before squaring, of a plane that nothing speaks for: it still counts among its like."""

_TO_CENTRES = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
"""From OpenCV's pixel positions, which count from the centre of the first pixel, to ours."""


@dataclass(frozen=True)
class PlaneSweep:
    """Depth by a plane sweep. Lengths are pixels or relative to depth: the world's unit is free."""

    confidence_weights: ClassVar[ConfidenceWeights] = ConfidenceWeights(
        8.56, 0.97, -1.19, -3.45, neighbourhood=5
    )
    """Fitted on validation pairs against true depth."""
    best_sources: int = 2
    """A plane is judged by its best few sources; the others may be occluded."""
    radius: int = 2
    """Half width of the matching window, in pixels."""
    cap: float = 0.8
    """Largest 1 - NCC that counts: beyond it, a source is occluded rather than a worse match."""
    spacing: float = 1.0
    """Distance of the planes, in pixels of the source that moves most from plane to plane."""
    small: float = 0.2
    """Cost of a step to the next plane along a path, as a share of the largest matching cost."""
    large: float = 1.2
    """Cost of a step to any plane; less at an edge of the picture."""
    contrast: float = 0.05
    """Grey-value difference (0 to 1) that halves `large`."""
    smooth_sigma: float = 0.06
    """Grey-value difference (0 to 1) over which planes are smoothed."""
    range_margin: float = 1.4
    """Factor by which the depth range of the sparse points is widened at either end."""
    max_cells: int = 2**27
    """Most pixels times planes, of 3 bytes each (400 MB); spacing grows to keep to it."""
    second: PatchMatch = field(default_factory=lambda: PatchMatch(consistent_sweeps=1))
    """Searches again in the second pass where other views did not confirm what was found."""

    def search(self, view: View, others: Sequence[View], points: np.ndarray) -> DepthMap:
        """First pass: depth of one view from pictures alone.

        Parameters
        ----------
        others : views
            The source views; without any, depth is NaN everywhere.
        points : array (n, 3)
            World points the view observes, may be empty: they bound the search.
        """
        if not others:
            return DepthMap.nothing(view.shape)
        w_range = inverse_depth_range(view, points, others, self.range_margin)
        if min(view.shape) >= COARSE * COARSE_MIN_SIDE:
            w_range = self._narrowed(pictures_at(view, others, COARSE), w_range)
        pictures = pictures_at(view, others, 1)
        w, costs = self._sweep(pictures, w_range, self.spacing)
        planes = np.empty((*w.shape, 3), np.float32)
        doubtful = np.minimum(costs, np.float32(1 - DOUBT))
        sharpness = np.float32(0.5 / self.smooth_sigma**2)
        smooth_planes(
            pictures.reference, with_slopes(w), doubtful, SMOOTH_RADIUS, SMOOTH_STRIDE, sharpness,
            planes,
        )  # fmt: skip
        depth = (1 / planes[..., 0]).astype(np.float32)
        depth[view.ignore] = np.nan
        return DepthMap(depth, costs, planes)

    def revise(
        self,
        view: View,
        others: Sequence[View],
        points: np.ndarray,
        found: DepthMap,
        settled: Bool[np.ndarray, "h w"],
    ) -> DepthMap:
        """Second pass: `second` tries slanted planes on the pixels that are not settled."""
        return self.second.revise(view, others, points, found, settled)

    def _narrowed(self, pictures: Pictures, w_range: tuple[float, float]) -> tuple[float, float]:
        """The part of a range of inverse depths in which coarse pictures match."""
        w, costs = self._sweep(pictures, w_range, COARSE_SPACING_PX)
        matched = w[costs < 0.5]
        if not len(matched):
            return w_range
        far, near = np.percentile(matched, [1, 99])
        return max(far / COARSE_MARGIN, w_range[0]), min(near * COARSE_MARGIN, w_range[1])

    def _sweep(
        self, pictures: Pictures, w_range: tuple[float, float], spacing: float
    ) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"]]:
        """Inverse depth of every pixel, and its matching cost from 0 to 1."""
        shape = pictures.reference.shape
        most = max(self.max_cells // pictures.reference.size, 3)
        count = int(np.ceil((w_range[1] - w_range[0]) * fastest(pictures, w_range) / spacing)) + 1
        inverse = np.linspace(*w_range, min(max(count, 3), most))
        volume = self._volume(pictures, inverse)
        totals = np.zeros(volume.shape, np.uint16)
        small, large = (int(kernels.WORST * change) for change in (self.small, self.large))
        for down, right in DIRECTIONS:
            kernels.scan(
                volume, pictures.reference, down, right, small, large, np.float32(self.contrast),
                totals,
            )  # fmt: skip
        numbers, costs = np.empty(shape, np.float32), np.empty(shape, np.float32)
        kernels.winners(totals, volume, numbers, costs)
        return (inverse[0] + numbers * (inverse[1] - inverse[0])).astype(np.float32), costs

    def _volume(
        self, pictures: Pictures, inverse: Float64[np.ndarray, "d"]
    ) -> UInt8[np.ndarray, "h w d"]:
        """Matching cost of every pixel at every inverse depth."""
        seen = np.isfinite(pictures.reference)
        reference = np.where(seen, pictures.reference, np.float32(0))
        looks = self._moments(reference)
        shown = [p[:h, :w] for p, (h, w) in zip(pictures.sources, pictures.sizes, strict=True)]
        known = [np.isfinite(picture).astype(np.uint8) for picture in shown]
        shown = [np.nan_to_num(picture) for picture in shown]
        volume = np.empty((len(inverse), *seen.shape), np.uint8)
        costs = np.empty((len(shown), *seen.shape), np.uint8)
        for d, w in enumerate(inverse):
            for s, warp in enumerate(pictures.warps):
                warped, inside = warp_by_plane(shown[s], known[s], warp, w, seen.shape)
                kernels.unlikeness(
                    looks, self._moments(warped), self._mean(reference * warped), inside,
                    np.float32(self.cap), costs[s],
                )  # fmt: skip
            kernels.mean_of_best(costs, self.best_sources, volume[d])
        volume = np.ascontiguousarray(np.moveaxis(volume, 0, 2))
        volume[~seen] = kernels.WORST
        return volume

    def _moments(self, grey: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "2 h w"]:
        """Mean and variance in the window around each pixel."""
        mean = self._mean(grey)
        return np.stack([mean, self._mean(grey * grey) - mean * mean])

    def _mean(self, values: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
        return np.asarray(cv2.blur(values, (2 * self.radius + 1,) * 2))


def warp_by_plane(
    picture: Float32[np.ndarray, "H W"],
    known: UInt8[np.ndarray, "H W"],
    warp: Float32[np.ndarray, "3 4"],
    inverse_depth: float,
    shape: tuple[int, int],
) -> tuple[Float32[np.ndarray, "h w"], UInt8[np.ndarray, "h w"]]:
    """A source as the view would see it if all it shows lay on one plane, and where it shows it.

    Parameters
    ----------
    known : array (H, W)
        0 where the source shows nothing.
    warp : array (3, 4)
        As in `Pictures.warps`.
    """
    to_source = warp[:, :3].astype(np.float64)
    to_source[:, 2] += warp[:, 3] * inverse_depth
    to_source = np.linalg.inv(_TO_CENTRES) @ to_source @ _TO_CENTRES
    height, width = shape
    warped = cv2.warpPerspective(
        picture, to_source, (width, height), borderMode=cv2.BORDER_REPLICATE,
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
    )  # fmt: skip
    inside = cv2.warpPerspective(
        known, to_source, (width, height), flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    )
    right, down, ahead = to_source[2]
    if ahead + min(right * width, 0) + min(down * height, 0) <= 0:  # some of it lies behind
        y, x = np.mgrid[:height, :width]
        inside[right * x + down * y + ahead <= 0] = 0
    return warped, inside


def fastest(pictures: Pictures, w_range: tuple[float, float]) -> float:
    """Pixels per unit of inverse depth by which the most demanding source's pixels move.

    Nine tenths of the pixels that the source shows, over all of the range, move less than that.
    """
    height, width = pictures.reference.shape
    steps = (np.arange(8) + 0.5) / 8
    x, y, w = (a.ravel() for a in np.meshgrid(steps * width, steps * height, np.linspace(*w_range)))
    speeds = [0.0]
    for (rows, columns), warp in zip(pictures.sizes, pictures.warps, strict=True):
        u, v, z = warp @ np.stack([x, y, np.ones_like(x), w])
        ahead = z > 0
        u, v, z = u[ahead] / z[ahead], v[ahead] / z[ahead], z[ahead]
        inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
        moves = np.hypot(warp[0, 3] - u * warp[2, 3], warp[1, 3] - v * warp[2, 3])[inside]
        if len(moves):
            speeds.append(float(np.percentile(moves / z[inside], 90)))
    return max(speeds)


def with_slopes(w: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w 3"]:
    """Inverse depth with its change per column and per row."""
    down, right = np.gradient(w)
    return np.stack([w, right, down], axis=-1).astype(np.float32)
