"""Where two pictures of the same camera differ: feature cue times structure cue."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from skimage.metrics import structural_similarity

from scenediff_classic.features.named import FEATURES
from scenediff_classic.protocols import FeatureExtractor
from scenediff_classic.types import View


@dataclass(frozen=True)
class CueConfig:
    """What counts as a difference."""

    features: FeatureExtractor = FEATURES["gradient-colour"]
    scale: float | None = 0.6
    """Feature difference, as a share of the largest one possible, that counts as 1; belongs to the
    features. None = between the least and the largest of each picture, as published: then every
    pair of pictures differs by 1 somewhere."""
    least: float = 0.5
    """Smaller feature cues are 0."""
    similar: float = 0.5
    """Pixels of a higher structural similarity look alike."""
    channels: tuple[int, ...] = field(default=(0, 1, 2))
    """Colours whose structure is compared; (0,), red alone, as published."""


def change_mask(
    view: View,
    image: UInt8[np.ndarray, "h w 3"],
    known: Bool[np.ndarray, "h w"],
    config: CueConfig,
) -> Float32[np.ndarray, "h w"]:
    """How much a picture differs from the view's, 0 to 1; NaN where it is not known.

    Parameters
    ----------
    image : array (h, w, 3)
        The other picture from the same camera.
    known : array (h, w)
        Where it tells something.
    """
    known = known & ~view.ignore
    filled = np.where(known[..., None], image, view.image)
    raw = feature_difference(view, filled, config.features)
    mask = feature_cue(raw, known, config) * structure_cue(view.image, filled, config)
    return np.where(known, mask, np.nan).astype(np.float32)


def feature_difference(
    view: View, image: UInt8[np.ndarray, "h w 3"], features: FeatureExtractor
) -> Float32[np.ndarray, "h w"]:
    """L1 distance of dense features at every pixel, as a share of the largest one possible."""
    grids = features(view), features(replace(view, image=image))
    coarse = np.abs(grids[0] - grids[1]).sum(axis=-1).astype(np.float32)
    most = np.abs(grids[0]).sum(axis=-1) + np.abs(grids[1]).sum(axis=-1)
    coarse = coarse / np.maximum(most.astype(np.float32), np.float32(1e-6))
    size = (view.shape[1], view.shape[0])
    return cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)


def feature_cue(
    raw: Float[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"], config: CueConfig
) -> Float32[np.ndarray, "h w"]:
    """The difference from 0 to 1, and 0 where it is small."""
    if config.scale is not None:
        cue = raw / config.scale
    elif known.any():
        low, high = float(raw[known].min()), float(raw[known].max())
        cue = (raw - low) / (high - low) if high > low else np.zeros_like(raw)
    else:
        cue = np.zeros_like(raw)
    cue = np.clip(cue, 0, 1)
    return np.where(cue < config.least, 0, cue).astype(np.float32)


def structure_cue(
    first: UInt8[np.ndarray, "h w 3"], second: UInt8[np.ndarray, "h w 3"], config: CueConfig
) -> Bool[np.ndarray, "h w"]:
    """True where local structure (SSIM, 11 x 11, sigma 1.5, mean of the colours) differs."""
    maps: Sequence[np.ndarray] = [
        structural_similarity(
            first[..., c], second[..., c], data_range=255, full=True, gaussian_weights=True,
            sigma=1.5, use_sample_covariance=False,
        )[1]
        for c in config.channels
    ]  # fmt: skip
    return np.mean(maps, axis=0) < config.similar
