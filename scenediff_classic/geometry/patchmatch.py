"""Multi-view stereo on the CPU: depth of every view from the other frames of its video.

PatchMatch with slanted planes, coarse to fine: random and neighbouring hypotheses compete for
every pixel by bilaterally weighted NCC over the best sources; then only depth that other views'
depth confirms is kept. It takes the place of the feed-forward depth of the paper (Sec. 4.1).
"""

import hashlib
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from scenediff_classic.geometry import kernels
from scenediff_classic.geometry.consistency import count_supporters
from scenediff_classic.geometry.pyramid import (
    Pictures,
    first_planes,
    pictures_at,
    upsample_planes,
)
from scenediff_classic.geometry.smoothing import smooth_planes
from scenediff_classic.geometry.view_selection import (
    inverse_depth_range,
    median_baseline,
    observed_points,
    select_sources,
)
from scenediff_classic.protocols import Progress
from scenediff_classic.types import Geometry, View
from scenediff_classic.workspace import load_npz, save_npz

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

FIRST_STEP_PX = 4.0
"""Largest random change of a plane in the first sweep, in pixels of parallax; then it halves."""

SMOOTH_RADIUS = 6
SMOOTH_STRIDE = 3
"""An odd stride meets both colours of the checkerboard, whose errors are less alike."""

_KEPT = {"digest", "depth", "cost"}


@dataclass(frozen=True)
class DepthMap:
    """Depth of one view before other views have confirmed it."""

    depth: Float32[np.ndarray, "h w"]
    cost: Float32[np.ndarray, "h w"]
    """1 - NCC, 0 (identical) to 1 (nothing found)."""


@dataclass(frozen=True)
class PatchMatchStereo:
    """Dense depth by PatchMatch multi-view stereo.

    Everything is measured in pixels or relative to depth: the world's unit does not matter.
    """

    sources: int = 5
    """Source views a reference view is matched against."""
    min_own_views: int = 3
    """A capture with fewer views also borrows sources from the other capture."""
    best_sources: int = 2
    """A plane is judged by its best few sources; the others may be occluded."""
    radius: int = 5
    """Half width of the matching window, in pixels."""
    stride: int = 2
    """Distance between the window's samples, in pixels."""
    grey_sigma: float = 0.05
    """Grey-value difference (0 to 1) that a bilateral weight tolerates."""
    smooth_sigma: float = 0.06
    """Grey-value difference (0 to 1) over which planes are smoothed."""
    sweeps: tuple[int, ...] = (4, 3, 2)
    """Sweeps over the picture at each pyramid level, coarsest first; each level doubles."""
    range_margin: float = 1.4
    """Factor by which the depth range of the sparse points is widened at either end."""
    max_cost: float = 0.6
    """Depth whose 1 - NCC is larger is dropped."""
    max_pixels: float = 1.5
    """Largest forward-backward error of a confirmed depth, in pixels."""
    max_relative: float = 0.01
    """Largest relative difference between depths that confirm each other."""
    min_supporters: int = 2
    """Views that must confirm a depth (fewer where a view has fewer sources)."""
    seed: int = 0

    def __call__(self, geometry: Geometry, workspace: Path, progress: Progress) -> Geometry:
        """Fill `depth`, `confidence` and `measured` of every view.

        Parameters
        ----------
        geometry : Geometry
            Cameras and pictures; any depth they hold is ignored.
        workspace : Path
            Finished depth maps are kept in ``stereo/`` below it and reused if cameras,
            pictures and options are the same.
        progress : callable
            ``progress("stereo", views done, views)``.

        Returns
        -------
        Geometry
            Same cameras. Depth is NaN where it could not be found or was not confirmed.
        """
        sources = [
            select_sources(geometry, i, count=self.sources, min_own=self.min_own_views)
            for i in range(len(geometry.views))
        ]
        seen = observed_points(geometry)
        maps = []
        for i, view in enumerate(geometry.views):
            progress("stereo", i, len(geometry.views))
            others = tuple(geometry.views[s] for s in sources[i])
            maps.append(self._kept_depth_map(view, others, geometry.points.xyz[seen[i]], workspace))
        progress("stereo", len(geometry.views), len(geometry.views))
        raw = [
            replace(view, depth=np.where(found.cost <= self.max_cost, found.depth, np.nan))
            for view, found in zip(geometry.views, maps, strict=True)
        ]
        confirmed = [
            self._confirm(raw[i], maps[i], [raw[s] for s in sources[i]]) for i in range(len(raw))
        ]
        return replace(geometry, views=tuple(confirmed))

    def depth_map(self, view: View, others: Sequence[View], points: np.ndarray) -> DepthMap:
        """Depth of one view from pictures alone, not yet confirmed.

        Parameters
        ----------
        others : views
            The source views; without any, depth is NaN everywhere.
        points : array (n, 3)
            World points the view observes, may be empty: they bound and start the search.
        """
        height, width = view.shape
        if not others:
            nothing = np.full((height, width), np.nan, np.float32)
            return DepthMap(nothing, np.ones_like(nothing))
        w_range = inverse_depth_range(view, points, others, self.range_margin)
        parallax = 1 / (view.intrinsics[0, 0] * median_baseline(view, others))
        levels = self._levels(height, width)
        planes, costs = np.empty((0, 0, 3), np.float32), np.empty((0, 0), np.float32)
        for level, sweeps in enumerate(levels):
            shrink = 2 ** (len(levels) - 1 - level)
            pictures = pictures_at(view, others, shrink)
            rules = self._rules(w_range, parallax * shrink)
            shape = pictures.reference.shape
            if level == 0:
                rng = np.random.default_rng([self.seed, view.index])
                planes = first_planes(view, points, shape, pictures.camera, w_range, rng)
            else:
                planes = upsample_planes(planes, shape)
            planes, costs = self._improve(pictures, rules, planes, level, sweeps)
        depth = (1 / planes[..., 0]).astype(np.float32)
        depth[view.ignore] = np.nan
        return DepthMap(depth, costs)

    def _improve(
        self,
        pictures: Pictures,
        rules: kernels.Rules,
        planes: Float32[np.ndarray, "h w 3"],
        level: int,
        sweeps: int,
    ) -> tuple[Float32[np.ndarray, "h w 3"], Float32[np.ndarray, "h w"]]:
        """Search on one pyramid level, smooth, and say what the smoothed planes cost."""
        costs = np.empty(planes.shape[:2], np.float32)
        kernels.score_planes(pictures, rules, planes, costs)
        explore = int(level == 0)
        for i in range(sweeps):
            amplitude = np.float32(FIRST_STEP_PX * 0.5 ** (i + level))
            for colour in (0, 1):
                draw = (self.seed * 31 + level * 64 + i * 2 + colour) % 2**31
                kernels.sweep(
                    pictures, rules, planes, costs, OFFSETS, colour, amplitude, explore, draw
                )
        smoothed = np.empty_like(planes)
        sharpness = np.float32(0.5 / self.smooth_sigma**2)
        smooth_planes(
            pictures.reference, planes, costs, SMOOTH_RADIUS, SMOOTH_STRIDE, sharpness, smoothed
        )
        kernels.score_planes(pictures, rules, smoothed, costs)
        return smoothed, costs

    def _levels(self, height: int, width: int) -> tuple[int, ...]:
        """Sweeps per level; levels that would be smaller than four windows are left out."""
        useful = 1
        while useful < len(self.sweeps) and min(height, width) >> useful >= 8 * self.radius:
            useful += 1
        return self.sweeps[:1] + self.sweeps[len(self.sweeps) - useful + 1 :]

    def _rules(self, w_range: tuple[float, float], parallax: float) -> kernels.Rules:
        return kernels.Rules(
            radius=self.radius,
            stride=self.stride,
            best=self.best_sources,
            sharpness=np.float32(0.5 / self.grey_sigma**2),
            nearness=np.float32(0.5 / self.radius**2),
            w_min=np.float32(w_range[0]),
            w_max=np.float32(w_range[1]),
            min_cosine=np.float32(0.1),
            parallax=np.float32(parallax),
        )

    def _confirm(self, view: View, found: DepthMap, others: Sequence[View]) -> View:
        """Keep what enough other views agree with, and say how sure it is."""
        supporters = count_supporters(
            view, others, max_pixels=self.max_pixels, max_relative=self.max_relative
        )
        needed = max(min(self.min_supporters, len(others)), 1)
        kept = (supporters >= needed) & np.isfinite(view.depth)
        share = supporters / (supporters + 1.0)
        confidence = np.where(kept, (1 - found.cost) * share, 0.0).astype(np.float32)
        depth = np.where(kept, view.depth, np.nan).astype(np.float32)
        return replace(view, depth=depth, confidence=confidence, measured=kept)

    def _kept_depth_map(
        self, view: View, others: Sequence[View], points: np.ndarray, workspace: Path
    ) -> DepthMap:
        """The depth map from an earlier run if it is the same work, else a new one, kept."""
        path = workspace / "stereo" / f"{view.video}_{view.index:05d}.npz"
        digest = np.array(self._digest(view, others, points))
        kept = load_npz(path)
        if kept is not None and kept.keys() == _KEPT and kept["digest"] == digest:
            return DepthMap(kept["depth"], kept["cost"])
        found = self.depth_map(view, others, points)
        save_npz(path, digest=digest, depth=found.depth, cost=found.cost)
        return found

    def _digest(self, view: View, others: Sequence[View], points: np.ndarray) -> str:
        """Changes whenever the depth map would."""
        digest = hashlib.sha256(repr(astuple(self)).encode())
        for v in (view, *others):
            for array in (v.image, v.intrinsics, v.cam_from_world, v.ignore):
                digest.update(np.ascontiguousarray(array).tobytes())
        digest.update(np.ascontiguousarray(points).tobytes())
        return digest.hexdigest()
