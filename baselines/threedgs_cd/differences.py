"""Where a rendered and a captured picture differ: steps 1 to 3 of 3DGS-CD, one view at a time."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from skimage.filters import threshold_otsu

from baselines.splat_change.models import Render
from baselines.splat_change.segmenting import (
    Box,
    BoxSegmenter,
    GrabCutBoxes,
    Segment,
    parts,
)
from scenediff_classic.features.colours import ColourFeatures
from scenediff_classic.protocols import FeatureExtractor
from scenediff_classic.types import View


@dataclass(frozen=True)
class DifferenceConfig:
    """What counts as a difference, and as a thing."""

    features: FeatureExtractor = field(default_factory=ColourFeatures)
    """What pictures are compared by."""
    blur: float = 0.03
    """Size of the blur before, as a share of the picture's width."""
    floor: float = 0.1
    """Least difference (1 - cosine of `features`) whatever Otsu's threshold is; 0 = none, as
    published: then every pair of pictures differs somewhere."""
    pooled: bool = True
    """One threshold for all views of a capture; False = one for each view, as published."""
    min_area: float = 0.003
    """Smallest difference and smallest thing, as a share of the picture (published: 0.01)."""
    inside: float = 0.5
    """Share of a thing that must lie where pictures differ; 0 = none, as published."""
    cover: float = 0.25
    """Share of a difference that its things must cover: what was uncovered may have a pattern,
    but none that explains the difference; 0 = none, as published."""
    segmenter: BoxSegmenter = field(default_factory=GrabCutBoxes)


@dataclass(frozen=True)
class ViewMasks:
    """The things that are only in the model (moved out) and only in the picture (moved in)."""

    out: tuple[Segment, ...]
    into: tuple[Segment, ...]
    changed: Bool[np.ndarray, "h w"]
    """Where the two differ."""


def difference(view: View, shown: Render, config: DifferenceConfig) -> Float32[np.ndarray, "h w"]:
    """1 - cosine of the features of the blurred pictures; NaN where the model knows nothing."""
    size = max(round(config.blur * view.shape[1]), 1)
    known = shown.known & ~view.ignore
    # the model is black where it knows nothing: that must not run into what it knows
    filled = np.where(known[..., None], shown.image, view.image)
    a, b = (
        config.features(replace(v, image=cv2.blur(image, (size, size))))
        for v, image in ((view, view.image), (shown.as_view(view), filled))
    )
    coarse = (1 - np.sum(a * b, axis=-1)).astype(np.float32)
    fine = cv2.resize(coarse, (view.shape[1], view.shape[0]), interpolation=cv2.INTER_LINEAR)
    return np.where(known, fine, np.float32(np.nan))


def thresholds(
    differences: Sequence[Float[np.ndarray, "h w"]], config: DifferenceConfig
) -> list[float]:
    """From which difference on a pixel changed, for each view: Otsu's, but never below the floor.

    Otsu's threshold splits whatever there is; the floor says what no picture differs by unless
    something changed.
    """
    known = [d[np.isfinite(d)] for d in differences]
    if config.pooled and known:
        known = [np.concatenate(known)] * len(known)
    return [max(_otsu(values), config.floor) for values in known]


def differing(
    values: Float[np.ndarray, "h w"], threshold: float, min_area: float
) -> list[tuple[Bool[np.ndarray, "h w"], Box]]:
    """Filled outlines of what is above the threshold and large enough, and their boxes."""
    above = (np.nan_to_num(values, nan=-1.0) > threshold).astype(np.uint8)
    contours, _ = cv2.findContours(above, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    out = []
    for contour in contours:
        mask = np.zeros(above.shape, np.uint8)
        cv2.drawContours(mask, [contour], -1, 1, cv2.FILLED)
        if mask.sum() >= min_area * mask.size:
            x, y, width, height = cv2.boundingRect(contour)
            out.append((mask > 0, (x, y, x + width, y + height)))
    return out


def things(
    view: View,
    shown: Render,
    values: Float[np.ndarray, "h w"],
    threshold: float,
    config: DifferenceConfig,
) -> ViewMasks:
    """Masks of what is in each difference, in the render and in the picture."""
    found = differing(values, threshold, config.min_area)
    everywhere = np.zeros(view.shape, bool)
    for mask, _ in found:
        everywhere |= mask
    out, into = (
        _distinct([s for mask, box in found for s in _segments(image, mask, box, config)])
        for image in (shown.image, view.image)
    )
    return ViewMasks(out, into, everywhere)


def _segments(
    image: np.ndarray, changed: Bool[np.ndarray, "h w"], box: Box, config: DifferenceConfig
) -> list[Segment]:
    segment = config.segmenter(image, box)
    if segment.score < config.segmenter.least:
        return []
    found = parts(segment, round(config.min_area * changed.size), changed, config.inside)
    covered = sum(int((s.mask & changed).sum()) for s in found)
    return found if covered >= config.cover * changed.sum() else []


def _distinct(segments: list[Segment]) -> tuple[Segment, ...]:
    """Without those that mostly repeat a better one: boxes overlap."""
    kept: list[Segment] = []
    for one in sorted(segments, key=lambda s: -s.score):
        area = one.mask.sum()
        if all((one.mask & other.mask).sum() < 0.5 * area for other in kept):
            kept.append(one)
    return tuple(kept)


def _otsu(values: Float[np.ndarray, "n"]) -> float:
    if len(values) == 0 or values.min() == values.max():
        return float("inf") if len(values) == 0 else float(values.max())
    return float(threshold_otsu(values))
