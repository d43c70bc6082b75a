"""From changes to the result and the evidence that every detector gives."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from baselines.splat_change.models import Render
from scenediff_classic.change.changed_regions import ChangedRegion
from scenediff_classic.change.describe import ConfidenceConfig
from scenediff_classic.change.moves import Change
from scenediff_classic.change.scale import rescaled
from scenediff_classic.change.visibility import VisibilityConfig, pair_views
from scenediff_classic.errors import OutputError
from scenediff_classic.pipeline import answer
from scenediff_classic.report.comparisons import difference_top, panels
from scenediff_classic.types import (
    Capture,
    ChangedObject,
    ChangeResult,
    Comparison,
    Evidence,
    Geometry,
    ScoreMaps,
    View,
)


@dataclass(frozen=True)
class AsScored(ConfidenceConfig):
    """An object is as sure as its masks."""

    def __call__(self, score: float, frames: float, placed: int) -> float:
        """The score itself."""
        return float(np.clip(score, 0, 1))


def answered(
    before: Capture,
    after: Capture,
    geometry: Geometry,
    changes: Sequence[Change],
    threshold: float,
    moved: Sequence[Change] = (),
) -> ChangeResult:
    """The changes as the result says them.

    Parameters
    ----------
    geometry : Geometry
        That the masks are meant in, in normalised units.
    moved : sequence of Change
        Things known in one capture alone that are called moved all the same.
    """
    result, more = (
        answer(before, after, geometry, part, threshold, AsScored()) for part in (changes, moved)
    )
    items = [_plain(item) for item in result.objects]
    items += [replace(_plain(item), kind="moved") for item in more.objects]
    items.sort(key=lambda item: -item.confidence)
    numbered = tuple(replace(item, id=k + 1) for k, item in enumerate(items))
    return replace(result, objects=numbered, threshold=threshold if numbered else None)


def evidence(
    estimated: Geometry,
    geometry: Geometry,
    feature: Mapping[int, Float[np.ndarray, "h w"]],
    total: Mapping[int, Float[np.ndarray, "h w"]],
    seconds: dict[str, float],
    comparisons: Sequence[Comparison],
) -> Evidence:
    """Maps of some views, by position, at the size of the estimated geometry's views."""
    maps = []
    for k, view in enumerate(estimated.views):
        unknown = np.full(view.shape, np.nan, np.float32)
        difference, score = (_enlarged(m.get(k), view) for m in (feature, total))
        maps.append(ScoreMaps(unknown, difference, unknown, score))
    world = estimated if estimated.unit == 1 else rescaled(estimated, 1 / estimated.unit)
    pairs = pair_views(geometry, VisibilityConfig())
    return Evidence(world, tuple(maps), pairs, seconds, tuple(comparisons))


def comparisons_of(
    geometry: Geometry,
    shown: Mapping[int, Render],
    difference: Mapping[int, Float32[np.ndarray, "h w"]],
    found: Mapping[int, Float[np.ndarray, "h w"]],
) -> tuple[Comparison, ...]:
    """What was compared, by position of the view; what has a score above 0 was found."""
    return tuple(
        Comparison(k, geometry.views[k].image, shown[k].image, difference[k], found[k] > 0)
        for k in sorted(shown)
    )


def painted_scores(
    regions: Sequence[ChangedRegion], geometry: Geometry
) -> dict[int, Float32[np.ndarray, "h w"]]:
    """The highest score at each pixel of each view; 0 where nothing is."""
    out = {k: np.zeros(v.shape, np.float32) for k, v in enumerate(geometry.views)}
    for region in regions:
        plane = out[region.view]
        plane[region.mask] = np.maximum(plane[region.mask], region.score)
    return out


def write_comparisons(folder: Path, geometry: Geometry, comparisons: Sequence[Comparison]) -> None:
    """A picture for each: captured, rendered, how much differs, what was found, side by side.

    Raises
    ------
    OutputError
        If a picture cannot be written.
    """
    top = difference_top(comparisons)
    for one in comparisons:
        view = geometry.views[one.view]
        row = np.hstack(panels(one, top))
        _written(folder / f"{view.video}_{view.index:04d}.jpg", row[..., ::-1])


def write_mask(path: Path, mask: Bool[np.ndarray, "h w"]) -> None:
    """A mask as a picture: 255 = changed.

    Raises
    ------
    OutputError
        If the picture cannot be written.
    """
    _written(path, mask.astype(np.uint8) * 255)


def _written(path: Path, picture: np.ndarray) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(cv2.imencode(path.suffix, picture)[1].tobytes())
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}.") from error


def _plain(item: ChangedObject) -> ChangedObject:
    """Without what belongs to the core's own method: no pairs of frames were compared."""
    return replace(item, support=None)


def _enlarged(plane: np.ndarray | None, view: View) -> Float32[np.ndarray, "h w"]:
    if plane is None:
        return np.full(view.shape, np.nan, np.float32)
    size = (view.shape[1], view.shape[0])
    return cv2.resize(plane.astype(np.float32), size, interpolation=cv2.INTER_NEAREST)
