"""Dense classical features: oriented gradients (DAISY-like layout) beside local colour histograms.

Two surfaces look alike when both their texture and their colours do; each half is a unit vector,
so the cosine similarity of the whole is the weighted mean of the halves' similarities.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32

from scenediff_classic.colour import lab_colours
from scenediff_classic.types import View


@dataclass(frozen=True)
class GradientColourFeatures:
    """Oriented-gradient and colour-histogram features on a regular grid.

    The gradient half follows DAISY (Tola et al., PAMI 2010): orientation maps pooled by Gaussians
    at the centre and on a ring. A noise floor joins the norm as a channel of its own, so that two
    plain surfaces agree instead of comparing their sensor noise. The colour half is the square
    root (Hellinger map) of a softly binned local histogram in Lab space.
    Exposure and white balance are expected to be equalised already (`change.harmonise`).
    """

    similarity: float = 0.93
    """Between the lowest true and the highest false pair but one of the rendered val pairs."""
    merge: float = 1.4
    stride: int = 4
    """Grid step, in working pixels."""
    orientations: int = 8
    ring_radius: float = 10.0
    """Distance of the ring's samples from the centre, in pixels of a 512-pixel-wide picture."""
    ring_samples: int = 6
    pooling_sigma: float = 4.0
    """Gaussian pooling at the centre; the ring pools 1.5 times wider. Same pixels."""
    noise_floor: float = 0.12
    """Pooled gradient energy below which a surface counts as plain."""
    lightness_bins: int = 6
    chroma_bins: int = 6
    """Bins along each of the two chroma axes."""
    gradient_weight: float = 0.5
    """Share of the gradient half in the similarity; the colour half has the rest."""

    def __call__(self, view: View) -> Float32[np.ndarray, "h w c"]:
        """Unit-length features, one per `stride` x `stride` cell."""
        lab = lab_colours(view.image)
        scale = max(view.shape) / 512
        gradients = self._gradients(lab[..., 0], scale) * np.float32(self.gradient_weight**0.5)
        colours = self._colours(lab, scale) * np.float32((1 - self.gradient_weight) ** 0.5)
        return np.concatenate([gradients, colours], axis=-1)

    def _gradients(self, lightness: Float32[np.ndarray, "H W"], scale: float) -> np.ndarray:
        contrast = local_contrast(lightness, 16 * scale)
        smooth = cv2.GaussianBlur(contrast, (0, 0), 1.0)
        dx = cv2.Scharr(smooth, cv2.CV_32F, 1, 0) / 32
        dy = cv2.Scharr(smooth, cv2.CV_32F, 0, 1) / 32
        angles = np.arange(self.orientations) * (2 * np.pi / self.orientations)
        centre, ring = [], []
        for angle in angles:
            response = np.maximum(np.cos(angle) * dx + np.sin(angle) * dy, 0)
            near = cv2.GaussianBlur(response, (0, 0), self.pooling_sigma * scale)
            centre.append(near)
            ring.append(cv2.GaussianBlur(near, (0, 0), self.pooling_sigma * scale * 1.118))
        height, width = lightness.shape
        y, x = self._grid(height, width)
        samples = [_at(centre, x, y)]
        for k in range(self.ring_samples):
            turn = 2 * np.pi * k / self.ring_samples
            dx_k = self.ring_radius * scale * np.cos(turn)
            dy_k = self.ring_radius * scale * np.sin(turn)
            samples.append(_at(ring, x + dx_k, y + dy_k))
        out = np.concatenate(samples, axis=-1)
        floor = np.full((*out.shape[:2], 1), self.noise_floor, np.float32)
        return _unit(np.concatenate([out, floor], axis=-1))

    def _colours(self, lab: Float32[np.ndarray, "H W 3"], scale: float) -> np.ndarray:
        lightness = _soft_bins(lab[..., 0], 0, 1, self.lightness_bins)
        red_green = _soft_bins(_compress(lab[..., 1]), -1, 1, self.chroma_bins)
        blue_yellow = _soft_bins(_compress(lab[..., 2]), -1, 1, self.chroma_bins)
        height, width = lab.shape[:2]
        y, x = self._grid(height, width)

        def pooled(channels: list[np.ndarray]) -> np.ndarray:
            sigma = self.pooling_sigma * scale
            return _at([cv2.GaussianBlur(c, (0, 0), sigma) for c in channels], x, y)

        chroma = [a * b for a in red_green for b in blue_yellow]
        parts = [pooled(lightness), pooled(chroma)]
        halves = [
            _unit(np.sqrt(np.maximum(p, 0))) * np.float32(w)
            for p, w in zip(parts, (0.35**0.5, 0.65**0.5), strict=True)
        ]  # light varies more than colour
        return np.concatenate(halves, axis=-1)

    def _grid(self, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
        rows = cell_centres(height, self.stride)
        columns = cell_centres(width, self.stride)
        x, y = np.meshgrid(columns, rows)
        return y, x


def cell_centres(length: int, stride: int) -> np.ndarray:
    """Centres of ceil(length / stride) equal cells, as continuous pixel coordinates."""
    count = -(-length // stride)
    return (np.arange(count) + 0.5) * (length / count)


def local_contrast(
    lightness: Float32[np.ndarray, "H W"], sigma: float
) -> Float32[np.ndarray, "H W"]:
    """Lightness relative to its surroundings, scaled to a common local spread."""
    mean = cv2.GaussianBlur(lightness, (0, 0), sigma)
    spread = cv2.GaussianBlur((lightness - mean) ** 2, (0, 0), sigma)
    return (lightness - mean) / np.sqrt(spread + 0.03**2)


def _compress(chroma: np.ndarray) -> np.ndarray:
    # fine steps near grey, where most indoor surfaces lie; coarse steps for vivid colours
    return np.sign(chroma) * np.minimum(np.sqrt(np.abs(chroma) / 0.8), 1)


def _soft_bins(values: np.ndarray, low: float, high: float, count: int) -> list[np.ndarray]:
    position = (np.clip(values, low, high) - low) / (high - low) * (count - 1)
    return [np.maximum(1 - np.abs(position - k), 0).astype(np.float32) for k in range(count)]


def _at(channels: list[np.ndarray], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    maps = (x - 0.5).astype(np.float32), (y - 0.5).astype(np.float32)
    return np.stack(
        [cv2.remap(c, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT) for c in channels],
        axis=-1,
    )


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-8)
    return (vectors / length).astype(np.float32)
