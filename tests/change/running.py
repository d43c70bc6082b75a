"""The method run on the analytic card scene with true geometry."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenediff_classic.pipeline import DetectConfig, detect_changes
from scenediff_classic.types import Capture, ChangeResult, Evidence, Frame, Geometry


@dataclass(frozen=True)
class Given:
    """A geometry estimator that answers with a geometry it was given."""

    geometry: Geometry

    def __call__(self, before, after, workspace: Path, progress) -> Geometry:
        return self.geometry


def captures(geometry: Geometry) -> tuple[Capture, Capture]:
    """Captures whose frames are the geometry's own pictures."""

    def of(video) -> Capture:
        frames = tuple(
            Frame(video, v.index, v.name, None, v.image, v.lens.width, v.lens.height)
            for v in geometry.of(video)
        )
        return Capture(video, f"{video} cards", frames)

    return of("before"), of("after")


def detect(geometry: Geometry, **options) -> tuple[ChangeResult, Evidence]:
    """Run the whole method with the geometry as given."""
    config = DetectConfig(geometry=Given(geometry), **options)
    return detect_changes(*captures(geometry), config)


def summary(result: ChangeResult) -> list[tuple[str, int]]:
    """(kind, number of views) of every object, in a canonical order."""
    return sorted((o.kind, len(o.views)) for o in result.objects)


def masks_of(result: ChangeResult) -> dict[tuple[str, int], np.ndarray]:
    """Union of all masks per (video, frame)."""
    from scenediff_classic.masks import decode

    out: dict[tuple[str, int], np.ndarray] = {}
    for item in result.objects:
        for view in item.views:
            key = view.video, view.frame
            out[key] = out.get(key, False) | decode(view.mask)
    return out
