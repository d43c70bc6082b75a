"""Local colour histograms: what a surface is coloured like, wherever its texture lies."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from scenediff_classic.colour import lab_colours
from scenediff_classic.features.cells import unit, width_factor
from scenediff_classic.features.pooling import pooled_over_picture, pooled_over_surface
from scenediff_classic.types import View


@dataclass(frozen=True)
class ColourFeatures:
    """Softly binned local histograms in Lab space, as their square roots (Hellinger map).

    Lightness has a histogram of its own, with a smaller weight: light varies more than colour.
    Exposure and white balance are expected to be equalised already (`change.harmonise`).
    """

    similarity: float = 0.943
    """This and `merge`: see `features.named`."""
    merge: float = 1.128
    stride: int = 4
    """Grid step, in working pixels."""
    pooling_sigma: float = 4.0
    """Gaussian pooling, in pixels of a picture whose long side is 512."""
    lightness_bins: int = 6
    chroma_bins: int = 6
    """Bins along each of the two chroma axes."""
    lightness_weight: float = 0.35
    """Share of lightness in the similarity; chroma has the rest."""
    depth_step: float = 0.0
    """Relative depth difference at which a histogram ends (see `pooled_over_surface`); 0 = it
    runs on across silhouettes."""

    def __call__(self, view: View) -> Float32[np.ndarray, "h w c"]:
        """Unit-length features, one per `stride` x `stride` cell."""
        lab = lab_colours(view.image)
        lightness = _soft_bins(lab[..., 0], 0, 1, self.lightness_bins)
        red_green = _soft_bins(_compress(lab[..., 1]), -1, 1, self.chroma_bins)
        blue_yellow = _soft_bins(_compress(lab[..., 2]), -1, 1, self.chroma_bins)
        chroma = [a * b for a in red_green for b in blue_yellow]
        halves = []
        for channels, weight in (
            (lightness, self.lightness_weight),
            (chroma, 1 - self.lightness_weight),
        ):
            pooled = unit(np.sqrt(np.maximum(self._pooled(channels, view), 0)))
            halves.append(pooled * np.float32(weight**0.5))
        return np.concatenate(halves, axis=-1)

    def _pooled(self, channels: list[np.ndarray], view: View) -> Float32[np.ndarray, "h w c"]:
        sigma = self.pooling_sigma * width_factor(view.shape)
        if self.depth_step > 0:
            return pooled_over_surface(channels, view, sigma, self.stride, self.depth_step)
        return pooled_over_picture(channels, view, sigma, self.stride)


def _compress(chroma: np.ndarray) -> np.ndarray:
    # fine steps near grey, where most indoor surfaces lie; coarse steps for vivid colours
    return np.sign(chroma) * np.minimum(np.sqrt(np.abs(chroma) / 0.8), 1)


def _soft_bins(values: np.ndarray, low: float, high: float, count: int) -> list[np.ndarray]:
    position = (np.clip(values, low, high) - low) / (high - low) * (count - 1)
    return [np.maximum(1 - np.abs(position - k), 0).astype(np.float32) for k in range(count)]
