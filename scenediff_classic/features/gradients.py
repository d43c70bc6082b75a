"""Oriented gradients in a DAISY-like layout: what a surface's texture looks like."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32

from scenediff_classic.colour import lab_colours
from scenediff_classic.features.cells import cell_grid, sampled_at, unit, width_factor
from scenediff_classic.types import View


@dataclass(frozen=True)
class GradientFeatures:
    """Orientation maps pooled by Gaussians at the centre and on a ring.

    Follows DAISY (Tola et al., PAMI 2010). A noise floor joins the norm as a channel of its own, so
    that two plain surfaces agree instead of comparing their sensor noise. Lengths are in pixels of
    a picture whose long side is 512.
    """

    similarity: float = 0.988
    """This and `merge`: see `features.named`."""
    merge: float = 1.317
    stride: int = 4
    """Grid step, in working pixels."""
    orientations: int = 8
    ring_radius: float = 10.0
    """Distance of the ring's samples from the centre."""
    ring_samples: int = 6
    pooling_sigma: float = 4.0
    """Gaussian pooling at the centre; the ring pools 1.5 times wider."""
    noise_floor: float = 0.12
    """Pooled gradient energy below which a surface counts as plain."""

    def __call__(self, view: View) -> Float32[np.ndarray, "h w c"]:
        """Unit-length features, one per `stride` x `stride` cell."""
        scale = width_factor(view.shape)
        contrast = local_contrast(lab_colours(view.image)[..., 0], 16 * scale)
        smooth = cv2.GaussianBlur(contrast, (0, 0), 1.0)
        dx = cv2.Scharr(smooth, cv2.CV_32F, 1, 0) / 32
        dy = cv2.Scharr(smooth, cv2.CV_32F, 0, 1) / 32
        sigma = self.pooling_sigma * scale
        centre, ring = [], []
        for angle in np.arange(self.orientations) * (2 * np.pi / self.orientations):
            response = np.maximum(np.cos(angle) * dx + np.sin(angle) * dy, 0)
            near = cv2.GaussianBlur(response, (0, 0), sigma)
            centre.append(near)
            ring.append(cv2.GaussianBlur(near, (0, 0), sigma * 1.118))
        x, y = cell_grid(view.shape, self.stride)
        samples = [sampled_at(centre, x, y)]
        for k in range(self.ring_samples):
            turn = 2 * np.pi * k / self.ring_samples
            right = self.ring_radius * scale * np.cos(turn)
            down = self.ring_radius * scale * np.sin(turn)
            samples.append(sampled_at(ring, x + right, y + down))
        floor = np.full((*x.shape, 1), self.noise_floor, np.float32)
        return unit(np.concatenate([*samples, floor], axis=-1))


def local_contrast(
    lightness: Float32[np.ndarray, "H W"], sigma: float
) -> Float32[np.ndarray, "H W"]:
    """Lightness relative to its surroundings, scaled to a common local spread."""
    mean = cv2.GaussianBlur(lightness, (0, 0), sigma)
    spread = cv2.GaussianBlur((lightness - mean) ** 2, (0, 0), sigma)
    return (lightness - mean) / np.sqrt(spread + 0.03**2)
