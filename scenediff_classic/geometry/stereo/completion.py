"""Guesses for unknown depth, marked as such: `View.measured` stays False for them.

Stereo finds nothing on bare walls and table tops. Where a patch of even colour holds enough
measured depth that lies on one plane, the rest of the patch is taken to lie on it too. Patches
end at colour edges, so depth does not bleed over them; without support, depth stays unknown.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int64
from skimage.segmentation import felzenszwalb

from scenediff_classic.types import Geometry, View

_TRIALS = 48
_SAMPLE = 400


@dataclass(frozen=True)
class DepthCompletion:
    """Fill unknown depth patch by patch with planes through the measured depth around it."""

    scales: tuple[float, ...] = (80.0, 320.0)
    """Patch sizes to try, small to large (Felzenszwalb's scale): near evidence goes first."""
    min_support: int = 30
    """Measured pixels a patch needs."""
    min_share: float = 0.2
    """Share of a patch's pixels that must be measured."""
    min_inliers: float = 0.75
    """Share of them that must lie on the plane."""
    tolerance: float = 0.01
    """Relative depth difference within which a pixel lies on the plane."""
    max_distance: float = 0.08
    """Farthest guess from any support of its plane, as a fraction of the longer side."""
    trust: float = 0.5
    """Confidence of a guess, relative to that of the depth it was made from."""
    seed: int = 0

    def __call__(self, geometry: Geometry) -> Geometry:
        """The same geometry with more depth; `measured` is unchanged."""
        return replace(geometry, views=tuple(self.complete(view) for view in geometry.views))

    def complete(self, view: View) -> View:
        """One view with guesses where its patches allow them."""
        if not view.measured.any():
            return view
        depth, confidence = view.depth.copy(), view.confidence.copy()
        smooth = cv2.bilateralFilter(view.image, 5, 20, 3)
        for scale in self.scales:
            open_pixels = ~np.isfinite(depth) & ~view.ignore
            patches = felzenszwalb(smooth, scale=scale, sigma=0.5, min_size=20)
            self._fill(view, patches, open_pixels, depth, confidence)
        return replace(view, depth=depth, confidence=confidence)

    def _fill(
        self,
        view: View,
        patches: Int64[np.ndarray, "h w"],
        open_pixels: Bool[np.ndarray, "h w"],
        depth: np.ndarray,
        confidence: np.ndarray,
    ) -> None:
        """Fill in place the open pixels of every patch that lies on a plane."""
        width = view.shape[1]
        order = np.argsort(patches, axis=None, kind="stable")
        starts = np.flatnonzero(np.diff(patches.ravel()[order])) + 1
        measured, wanted = view.measured.ravel(), open_pixels.ravel()
        for number, members in enumerate(np.split(order, starts)):
            support, targets = members[measured[members]], members[wanted[members]]
            enough = max(self.min_support, self.min_share * len(members))
            if len(support) < enough or not len(targets):
                continue
            xy = np.stack([support % width, support // width], axis=1) + 0.5
            inverse = 1 / view.depth.ravel()[support].astype(np.float64)
            plane, on_plane = fit_plane(
                xy, inverse, self.tolerance, np.random.default_rng([self.seed, number])
            )
            share = float(on_plane.mean())
            if share < self.min_inliers:
                continue
            targets = targets[self._near(targets, support[on_plane], view.shape)]
            guess = np.c_[targets % width + 0.5, targets // width + 0.5, np.ones(len(targets))]
            found = guess @ plane
            low, high = inverse[on_plane].min(), inverse[on_plane].max()
            fits = (found > low * 0.8) & (found < high * 1.25)
            depth.ravel()[targets[fits]] = 1 / found[fits]
            trust = self.trust * share * float(np.median(view.confidence.ravel()[support]))
            confidence.ravel()[targets[fits]] = trust

    def _near(
        self, targets: np.ndarray, support: np.ndarray, shape: tuple[int, int]
    ) -> Bool[np.ndarray, "n"]:
        """Which targets (flat indices) are close enough to the support."""
        away = np.ones(shape, np.uint8)
        away.ravel()[support] = 0
        distance = cv2.distanceTransform(away, cv2.DIST_L2, 3)
        return distance.ravel()[targets] <= self.max_distance * max(shape)


def fit_plane(
    xy: Float64[np.ndarray, "n 2"],
    inverse_depth: Float64[np.ndarray, "n"],
    tolerance: float,
    rng: np.random.Generator,
) -> tuple[Float64[np.ndarray, "3"], Bool[np.ndarray, "n"]]:
    """Robust plane ``inverse depth = a x + b y + c`` and which pixels lie on it.

    The best of some random three-pixel planes, refitted to its inliers. A plane in space is
    exactly affine in inverse depth over the picture.
    """
    design = np.c_[xy, np.ones(len(xy))]
    used = np.arange(len(xy))
    if len(used) > _SAMPLE:
        used = rng.choice(used, _SAMPLE, replace=False)
    corners = rng.choice(used, (_TRIALS, 3))
    corners = corners[np.abs(np.linalg.det(design[corners])) > 1.0]  # a triangle, not a line
    if not len(corners):
        return np.zeros(3), np.zeros(len(xy), bool)
    planes = np.linalg.solve(design[corners], inverse_depth[corners][..., None])[..., 0]
    error = np.abs(design[used] @ planes.T / inverse_depth[used, None] - 1)
    best = planes[np.argmax(np.sum(error < tolerance, axis=0))]
    for _ in range(2):
        on_plane = np.abs(design @ best / inverse_depth - 1) < tolerance
        best = np.linalg.lstsq(design[on_plane], inverse_depth[on_plane], rcond=None)[0]
    return best, np.abs(design @ best / inverse_depth - 1) < tolerance
