"""Small truths and predictions for the tests: masks are rectangles, frames are sampled ones."""

import numpy as np

from scenediff_classic import masks
from scenediff_classic.dataset import (
    SAMPLE_STEP,
    AnnotatedMask,
    AnnotatedObject,
    AnnotatedPair,
    PredictedObject,
    PredictedView,
    Prediction,
    Track,
)
from scenediff_classic.types import VIDEOS, Kind, Rle, Video

SIZE = (1024, 1024)
"""Square and already as large as the grid: neither mode resizes."""
KIND_OF: dict[tuple[Video, ...], Kind] = {
    ("before",): "removed",
    ("after",): "added",
    ("before", "after"): "moved",
}
Views = dict[Video, dict[int, Rle]]
"""Capture -> sampled frame -> mask."""


def box(x: int, y: int, width: int, height: int, size: tuple[int, int] = SIZE) -> Rle:
    mask = np.zeros(size, bool)
    mask[y : y + height, x : x + width] = True
    return masks.encode(mask)


def truth(*objects: Views) -> AnnotatedPair:
    """Objects are flagged in the captures that they name, even with no frame there."""
    return AnnotatedPair(
        "test",
        tuple(
            Track(video, i, tuple(AnnotatedMask(SAMPLE_STEP * k, m) for k, m in views.items()))
            for video in VIDEOS
            for i, item in enumerate(objects)
            for views in [item.get(video)]
            if views is not None
        ),
        tuple(
            AnnotatedObject(i, f"thing_{i}", "before" in item, "after" in item)
            for i, item in enumerate(objects)
        ),
    )


def prediction(*objects: tuple[float, Views]) -> Prediction:
    """Each object: the confidence of all its views, and the views."""
    return Prediction(tuple(predicted(i, c, views) for i, (c, views) in enumerate(objects)), SIZE)


def predicted(number: int, confidence: float, item: Views) -> PredictedObject:
    views = [
        PredictedView(video, k, confidence, mask)
        for video in VIDEOS
        for k, mask in item.get(video, {}).items()
    ]
    kind = KIND_OF[tuple(video for video in VIDEOS if video in item)]
    return PredictedObject(number, kind, tuple(views))
