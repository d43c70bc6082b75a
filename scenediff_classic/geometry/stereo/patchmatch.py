"""Depth of one view by PatchMatch: slanted planes compete for every pixel, coarse to fine.

Random and neighbouring hypotheses are judged by bilaterally weighted NCC in the best sources. A
second pass, once every view has depth, also asks what depth the sources found themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Bool, Float32

from scenediff_classic.devices import Device
from scenediff_classic.geometry.stereo.depth_confidence import ConfidenceWeights
from scenediff_classic.geometry.stereo.depth_map import DepthMap
from scenediff_classic.geometry.stereo.devices import Kernels, kernels_for
from scenediff_classic.geometry.stereo.kernels import Rules
from scenediff_classic.geometry.stereo.pyramid import (
    Pictures,
    first_planes,
    pictures_at,
    upsample_planes,
)
from scenediff_classic.geometry.stereo.view_selection import inverse_depth_range, median_baseline
from scenediff_classic.types import View

NEAR = ((-1, 0), (-2, -1), (-2, 1), (-3, -2), (-3, 2))
FAR = ((-3, 0), (-5, 0), (-7, 0), (-9, 0), (-11, 0))
"""Upward (row, column) steps to neighbours that may hand on their plane; turned to all sides."""


def _rotations(steps: tuple[tuple[int, int], ...]) -> list[list[tuple[int, int]]]:
    """The steps turned by 0, 90, 180 and 270 degrees."""
    turned = [list(steps)]
    for _ in range(3):
        turned.append([(c, -r) for r, c in turned[-1]])
    return turned


OFFSETS = np.array(_rotations(NEAR) + _rotations(FAR), np.int32)
"""(8, 5, 2): groups of (row, column) steps of which the cheapest one hands on its plane."""

FIRST_STEP_PX = 2.0
"""Largest random change of a plane in the first sweep, in pixels of parallax; then it halves."""

SECOND_STEP_PX = 1.0
"""The same for the second pass."""

SMOOTH_RADIUS = 6
SMOOTH_STRIDE = 3
"""An odd stride meets both colours of the checkerboard, whose errors are less alike."""

DOUBT = 0.1
"""Weight, before squaring, of a plane that nothing speaks for: it still counts among its like."""


@dataclass(frozen=True)
class PatchMatch:
    """Depth by PatchMatch. Lengths are pixels or relative to depth: the world's unit is free."""

    confidence_weights: ClassVar[ConfidenceWeights] = ConfidenceWeights(
        9.12, 0.83, -1.53, -3.53, neighbourhood=5
    )
    """Fitted on the validation pairs against true depth."""
    best_sources: int = 2
    """A plane is judged by its best few sources; the others may be occluded."""
    radius: int = 4
    """Half width of the matching window, in pixels."""
    grey_sigma: float = 0.05
    """Grey-value difference (0 to 1) that a bilateral weight tolerates."""
    cap: float = 0.4
    """Largest 1 - NCC that counts: beyond it, a source is occluded rather than a worse match."""
    smooth_sigma: float = 0.06
    """Grey-value difference (0 to 1) over which planes are smoothed."""
    sweeps: tuple[int, ...] = (4, 3, 2, 2)
    """Sweeps over the picture at each pyramid level, coarsest first; each level doubles."""
    consistency: float = 0.2
    """Second pass: cost of a plane that a source's own depth contradicts, beside the 1 - NCC."""
    tolerance: float = 2.0
    """Forward-backward error (pixels) from which a source's depth contradicts entirely."""
    consistent_sweeps: int = 2
    """Sweeps of the second pass."""
    range_margin: float = 1.4
    """Factor by which the depth range of the sparse points is widened at either end."""
    seed: int = 0
    device: Device = field(default="auto", repr=False)
    """Where to compute. Not part of what is printed, and so of the digest of a kept depth map:
    both devices find the same depth but for near ties, so a run may continue on the other one."""

    def search(self, view: View, others: Sequence[View], points: np.ndarray) -> DepthMap:
        """First pass: depth of one view from pictures alone.

        Parameters
        ----------
        others : views
            The source views; without any, depth is NaN everywhere.
        points : array (n, 3)
            World points the view observes, may be empty: they bound and start the search.
        """
        if not others:
            return DepthMap.nothing(view.shape)
        w_range, parallax = self._range(view, others, points)
        levels = self._levels(*view.shape)
        planes = np.empty((0, 0, 3), np.float32)
        costs = np.empty((0, 0), np.float32)
        for level, sweeps in enumerate(levels):
            shrink = 2 ** (len(levels) - 1 - level)
            pictures = pictures_at(view, others, shrink)
            rules = self.rules(w_range, parallax * shrink, consistency=0.0)
            shape = pictures.reference.shape
            if level == 0:
                rng = np.random.default_rng([self.seed, view.index])
                planes = first_planes(view, points, shape, pictures.camera, w_range, rng)
            else:
                planes = upsample_planes(planes, shape)
            steps = [FIRST_STEP_PX * 0.5 ** (i + level) for i in range(sweeps)]
            planes, costs = self._improve(
                pictures, rules, planes, np.zeros(shape, bool), steps,
                explore=int(level == 0), draw=64 * level,
            )  # fmt: skip
        return self._depth_map(view, planes, costs)

    def revise(
        self,
        view: View,
        others: Sequence[View],
        points: np.ndarray,
        found: DepthMap,
        settled: Bool[np.ndarray, "h w"],
    ) -> DepthMap:
        """Second pass: search again where it is in doubt, comparing with the sources' depth.

        Parameters
        ----------
        others : views
            The source views, each with the depth that it found itself.
        found : DepthMap
            What the first pass found.
        settled : bool array (h, w)
            Pixels whose plane is not searched again.
        """
        if not others:
            return found
        w_range, parallax = self._range(view, others, points)
        pictures = pictures_at(view, others, 1)
        rules = self.rules(w_range, parallax, consistency=self.consistency)
        steps = [SECOND_STEP_PX * 0.5**i for i in range(self.consistent_sweeps)]
        planes, costs = self._improve(
            pictures, rules, found.planes, settled, steps, explore=0, draw=1024
        )
        return self._depth_map(view, planes, costs)

    def _improve(
        self,
        pictures: Pictures,
        rules: Rules,
        planes: Float32[np.ndarray, "h w 3"],
        settled: Bool[np.ndarray, "h w"],
        steps: Sequence[float],
        *,
        explore: int,
        draw: int,
    ) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
        """Search on one pyramid level, smooth, and say how unlike the smoothed planes look.

        0 = identical in the best sources, 1 = the cap.
        """
        kernels = kernels_for(self.device)
        loaded = kernels.load(pictures)
        windows = kernels.prepare_windows(loaded.reference, self.radius, self.grey_sigma)
        planes, costs = planes.copy(), np.empty(planes.shape[:2], np.float32)
        kernels.score_planes(loaded, windows, rules, planes, costs)
        for i, step in enumerate(steps):
            for colour in (0, 1):
                seed = (self.seed * 31 + draw + i * 2 + colour) % 2**31
                kernels.sweep(
                    loaded, windows, rules, planes, costs, settled, OFFSETS, colour,
                    np.float32(step), explore, seed,
                )  # fmt: skip
        planes = self._smoothed(kernels, loaded, planes, costs / (rules.cap + rules.consistency))
        looks = rules._replace(consistency=np.float32(0))  # not what depth the sources found
        kernels.score_planes(loaded, windows, looks, planes, costs)
        return planes, costs / rules.cap

    def _smoothed(
        self, kernels: Kernels, loaded: Any, planes: np.ndarray, costs: Float32[np.ndarray, "h w"]
    ) -> Float32[np.ndarray, "h w 3"]:
        smoothed = np.empty_like(planes)
        doubtful = np.minimum(costs, np.float32(1 - DOUBT))
        sharpness = np.float32(0.5 / self.smooth_sigma**2)
        kernels.smooth_planes(
            loaded.reference, planes, doubtful, SMOOTH_RADIUS, SMOOTH_STRIDE, sharpness, smoothed
        )
        return smoothed

    def _depth_map(self, view: View, planes: np.ndarray, costs: np.ndarray) -> DepthMap:
        depth = (1 / planes[..., 0]).astype(np.float32)
        depth[view.ignore] = np.nan
        return DepthMap(depth, costs, planes)

    def _levels(self, height: int, width: int) -> tuple[int, ...]:
        """Sweeps per level; levels that would be smaller than four windows are left out."""
        useful = 1
        while useful < len(self.sweeps) and min(height, width) >> useful >= 8 * self.radius:
            useful += 1
        return self.sweeps[:1] + self.sweeps[len(self.sweeps) - useful + 1 :]

    def _range(
        self, view: View, others: Sequence[View], points: np.ndarray
    ) -> tuple[tuple[float, float], float]:
        """Inverse depths to search, and the step between them that is about one pixel."""
        w_range = inverse_depth_range(view, points, others, self.range_margin)
        return w_range, 1 / (view.intrinsics[0, 0] * median_baseline(view, others))

    def rules(self, w_range: tuple[float, float], parallax: float, *, consistency: float) -> Rules:
        """What a plane may be: `w_range` in inverse depth, `parallax` in inverse depth a pixel."""
        return Rules(
            radius=self.radius,
            best=self.best_sources,
            w_min=np.float32(w_range[0]),
            w_max=np.float32(w_range[1]),
            min_cosine=np.float32(0.1),
            cap=np.float32(self.cap),
            consistency=np.float32(consistency),
            tolerance=np.float32(self.tolerance),
            parallax=np.float32(parallax),
        )
