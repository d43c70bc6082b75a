"""Local binary patterns: which texture a surface has, however it is turned and lit."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32
from skimage.feature import local_binary_pattern

from scenediff_classic.features.cells import unit, width_factor
from scenediff_classic.features.pooling import pooled_over_picture
from scenediff_classic.types import View


@dataclass(frozen=True)
class BinaryPatternFeatures:
    """Histograms of rotation-invariant uniform patterns (Ojala et al., PAMI 2002), several radii.

    A pattern only says which of the pixels around are brighter, so any change of exposure leaves
    it as it is. Square roots of the pooled histograms (Hellinger map).
    """

    similarity: float = 0.994
    """This and `merge`: see `features.named`."""
    merge: float = 1.328
    stride: int = 4
    """Grid step, in working pixels."""
    radii: tuple[float, ...] = (1.5, 3.0)
    """Radii of the circles of 8 pixels, in pixels of a picture whose long side is 512."""
    pooling_sigma: float = 6.0
    """Gaussian pooling, same pixels."""
    dead_zone: float = 3.0
    """Grey levels by which a pixel around must be brighter: above the sensor's noise."""

    def __call__(self, view: View) -> Float32[np.ndarray, "h w c"]:
        """Unit-length features, one per `stride` x `stride` cell."""
        scale = width_factor(view.shape)
        grey = cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY)
        grey = cv2.GaussianBlur(grey, (0, 0), scale)
        levels = np.floor(grey / self.dead_zone).astype(np.uint8)
        halves = []
        for radius in self.radii:
            codes = local_binary_pattern(levels, 8, radius * scale, "uniform")
            maps = [(codes == k).astype(np.float32) for k in range(10)]
            pooled = pooled_over_picture(maps, view, self.pooling_sigma * scale, self.stride)
            halves.append(unit(np.sqrt(np.maximum(pooled, 0))))
        return unit(np.concatenate(halves, axis=-1))
