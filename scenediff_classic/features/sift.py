"""Dense RootSIFT: gradient histograms of a 4 x 4 raster around every cell."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32

from scenediff_classic.colour import lab_colours
from scenediff_classic.features.cells import cell_grid, sampled_at, unit, width_factor
from scenediff_classic.features.gradients import local_contrast
from scenediff_classic.types import View


@dataclass(frozen=True)
class SiftFeatures:
    """Upright SIFT (Lowe, IJCV 2004) at every cell, as its square root (Arandjelovic, CVPR 2012).

    SIFT forgets how strong the texture is, so that plain surfaces would compare their sensor
    noise; the strength comes back as the share of a constant channel, which is all that is left
    of a plain surface.
    """

    similarity: float = 0.961
    """This and `merge`: see `features.named`."""
    merge: float = 1.306
    stride: int = 4
    """Grid step, in working pixels."""
    size: float = 5.0
    """SIFT's key point diameter, in pixels of a picture whose long side is 512: a raster's
    cell measures 1.5 of it."""
    noise_floor: float = 0.15
    """Pooled gradient energy of a surface whose texture counts half."""

    def __call__(self, view: View) -> Float32[np.ndarray, "h w c"]:
        """Unit-length features, one per `stride` x `stride` cell."""
        scale = width_factor(view.shape)
        x, y = cell_grid(view.shape, self.stride)
        places = [
            cv2.KeyPoint(float(u) - 0.5, float(v) - 0.5, self.size * scale, 0)
            for u, v in zip(x.ravel(), y.ravel(), strict=True)
        ]
        grey = cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY)
        found = cv2.SIFT.create().compute(grey, places)[1].reshape(*x.shape, -1)
        root = np.sqrt(found / np.maximum(found.sum(axis=-1, keepdims=True), 1e-8))
        energy = sampled_at([self._energy(view, scale)], x, y)
        return unit(
            np.concatenate([root * energy, np.full_like(energy, self.noise_floor)], axis=-1)
        )

    def _energy(self, view: View, scale: float) -> Float32[np.ndarray, "H W"]:
        contrast = local_contrast(lab_colours(view.image)[..., 0], 16 * scale)
        smooth = cv2.GaussianBlur(contrast, (0, 0), 1.0)
        dx, dy = (cv2.Scharr(smooth, cv2.CV_32F, *d) / 32 for d in ((1, 0), (0, 1)))
        return cv2.GaussianBlur(np.hypot(dx, dy), (0, 0), self.size * 0.75 * scale)
