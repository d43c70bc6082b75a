"""Training pairs out of annotated captures and the geometry that a finished run found for them.

As the paper's supplement describes it for CYWS-2D*: two frames that share more than half of what
they show; in either the boxes of the changed objects, if their place is seen in the other.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float32

from baselines.cyws.pairs import TwoViews
from baselines.cyws.view_pairs import two_views
from scenediff_classic.cameras import inside, project, sample, undistort, unproject
from scenediff_classic.change.scale import normalised
from scenediff_classic.change.visibility import VisibilityConfig, covisibility
from scenediff_classic.dataset import SAMPLE_STEP, AnnotatedPair, read_annotations
from scenediff_classic.errors import InputError
from scenediff_classic.geometry.store import SavedGeometry
from scenediff_classic.masks import decode
from scenediff_classic.protocols import silent
from scenediff_classic.types import VIDEOS, Capture, Video, View
from scenediff_classic.video import read_capture

Labels = Literal["standing", "both"]
"""``standing``: a picture has the boxes of objects that stand in it (the paper's directional
ones). ``both``: it has those of the other picture's as well, where they would be."""

VISIBILITY = VisibilityConfig()
"""Two views are a pair above half of co-visibility, as the method's own."""
LEAST_SEEN = 0.5
"""Share of an object's points of known depth that must be seen in the other picture."""
LEAST_POINTS = 20
"""Of an object, with known depth, to carry it over."""
_SOURCES: tuple[dict[Video, str], ...] = (
    {"before": "before", "after": "after"},
    {"before": "original_video1.mp4", "after": "original_video2.mp4"},
)


def read_annotated(
    pair: Path,
    run: Path,
    size: tuple[int, int],
    labels: Labels = "standing",
    visibility: VisibilityConfig = VISIBILITY,
) -> Iterator[TwoViews]:
    """All pairs of frames of an annotated pair of captures that share enough.

    Parameters
    ----------
    pair : Path
        Folder with ``segments.json`` or ``segments.pkl`` and the captures: folders ``before`` and
        ``after``, or ``original_video1.mp4`` and ``original_video2.mp4``.
    run : Path
        Finished output of `scenediff-classic detect` or another method on the same captures.
    size : (height, width)
        Of the network's pictures.
    visibility : VisibilityConfig
        Says how much two views must share.

    Raises
    ------
    InputError
        If something is missing, damaged, or of other captures.
    """
    truth = read_annotations(pair)
    captures = [_capture(pair, video) for video in VIDEOS]
    geometry = normalised(SavedGeometry(run)(captures[0], captures[1], run, silent))
    shared = covisibility(geometry, visibility)
    before, after = geometry.of("before"), geometry.of("after")
    masks = {view.key: _masks(view, truth) for view in geometry.views}
    for i, j in np.argwhere(shared > visibility.pair_covisibility):
        ends = before[i], after[j]
        boxes = [
            _boxes(masks[ends[side].key], ends[side], ends[1 - side], side, labels, visibility)
            for side in (0, 1)
        ]
        scale = np.array([_scale(view, size) for view in ends], np.float32)
        found = np.concatenate([np.zeros((0, 2, 4), np.float32), *boxes]) * scale
        yield replace(two_views(*ends, *size), boxes=found.astype(np.float32))


def box_of(mask: Bool[np.ndarray, "h w"]) -> tuple[float, float, float, float] | None:
    """x0, y0, x1, y1 in pixels; None for an empty mask."""
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return None
    return float(columns[0]), float(rows[0]), float(columns[-1] + 1), float(rows[-1] + 1)


def _capture(pair: Path, video: Video) -> Capture:
    for names in _SOURCES:
        if (pair / names[video]).exists():
            return read_capture(pair / names[video], video)
    number = VIDEOS.index(video) + 1
    raise InputError(f"{pair} holds neither a folder '{video}' nor original_video{number}.mp4.")


def _masks(view: View, truth: AnnotatedPair) -> list[Bool[np.ndarray, "h w"]]:
    """Of the changed objects annotated in a view."""
    changed = {o.object_id for o in truth.objects if o.kind and o.present(view.video)}
    out = []
    for track in truth.tracks:
        if track.video != view.video or track.object_id not in changed:
            continue
        for item in track.masks:
            if item.frame == view.index * SAMPLE_STEP:
                soft = decode(item.mask).astype(np.float32)
                out.append(undistort(soft, view.lens, view.intrinsics, *view.shape)[0] > 0.5)
    return out


def _boxes(
    masks: list[Bool[np.ndarray, "h w"]],
    own: View,
    other: View,
    side: int,
    labels: Labels,
    visibility: VisibilityConfig,
) -> Float32[np.ndarray, "n 2 4"]:
    """Of one view's objects: in it, and where they would be in the other view (or nothing)."""
    points = unproject(own)
    out = []
    for mask in masks:
        box = box_of(mask)
        there = _carried(points[mask & ~own.ignore], other, visibility)
        if box is None or there is None:
            continue
        pair = np.zeros((2, 4), np.float32)
        pair[side] = box
        if labels == "both":
            pair[1 - side] = there
        out.append(pair)
    return np.array(out, np.float32).reshape(-1, 2, 4)


def _carried(
    points: Float32[np.ndarray, "n 3"], view: View, visibility: VisibilityConfig
) -> tuple[float, float, float, float] | None:
    """Box of an object's points in another view; None if less than half of them is seen there."""
    points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    if len(points) < LEAST_POINTS:
        return None
    xy, z = project(points, view.intrinsics, view.cam_from_world)
    height, width = view.shape
    seen = inside(xy, height, width) & (z > 0)
    surface = np.full(len(points), np.nan)
    surface[seen] = sample(view.depth, xy[seen][None], nearest=True)[0]
    seen &= ~(surface - z < visibility.occlusion)  # unknown depth hides nothing
    if seen.mean() < LEAST_SEEN:
        return None
    # a few points on the outline have the depth of what is behind
    low, high = np.percentile(xy[seen], [2, 98], axis=0)
    x0, y0 = (float(v) for v in low)
    x1, y1 = (float(v) for v in high)
    return (x0, y0, x1, y1) if x1 > x0 and y1 > y0 else None


def _scale(view: View, size: tuple[int, int]) -> np.ndarray:
    x, y = size[1] / view.shape[1], size[0] / view.shape[0]
    return np.array([x, y, x, y])
