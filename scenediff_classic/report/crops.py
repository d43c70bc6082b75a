"""Close-ups of a changed object: where it is seen best, and the same place in the other capture."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from scenediff_classic.cameras import inside, project, source_from_view
from scenediff_classic.masks import area
from scenediff_classic.report.drawing import mask_at, outline, views_in
from scenediff_classic.report.palette import INK, KIND_COLOUR, Colour
from scenediff_classic.types import (
    VIDEOS,
    Capture,
    ChangedObject,
    Frame,
    Geometry,
    ObjectView,
    Video,
    View,
)

_MARGIN = 0.35
"""Surroundings shown on each side, as a share of the object's longer side."""
_SIDE = 176
"""Side of a close-up in pixels."""
_TRUSTED = 0.6
"""Among views at least this large, relative to the largest, the most confident one is shown."""

_Box = tuple[float, float, float, float]
"""Left, top, right, bottom, in pixels of a frame's picture."""


@dataclass(frozen=True)
class Crop:
    """A square close-up."""

    image: UInt8[np.ndarray, "side side 3"]
    frame: int
    """Index of the frame it was cut from."""
    shows_object: bool
    """False: the place where the object is in the other capture, projected into this one."""


def crops_of(
    item: ChangedObject, geometry: Geometry, captures: dict[Video, Capture]
) -> dict[Video, Crop | None]:
    """A close-up from each capture; None where the object's place is in no picture."""
    return {
        video: _object_crop(item, video, captures[video])
        or _place_crop(item, geometry, captures[video])
        for video in VIDEOS
    }


def best_view(item: ChangedObject, video: Video) -> ObjectView | None:
    """The view of a capture that shows the object best: large, and among the large confident."""
    views = views_in(item, video)
    if not views:
        return None
    sizes = {view.frame: area(view.mask) for view in views}
    largest = max(sizes.values())
    trusted = [view for view in views if sizes[view.frame] >= _TRUSTED * largest]
    return max(trusted, key=lambda view: (view.confidence, sizes[view.frame], -view.frame))


def _object_crop(item: ChangedObject, video: Video, capture: Capture) -> Crop | None:
    view = best_view(item, video)
    frame = None if view is None else _frame(capture, view.frame)
    if view is None or frame is None:
        return None
    height, width = frame.image.shape[:2]
    mask = mask_at(view, height, width)
    x, y, wide, high = cv2.boundingRect(mask.astype(np.uint8))
    if wide == 0:
        return None
    left, top, side = _window((x, y, x + wide, y + high))
    close_up = _cut(frame.image, left, top, side)
    close_mask = _cut(mask.astype(np.uint8) * 255, left, top, side) > 127
    outline(close_up, close_mask, KIND_COLOUR[item.kind], 2)
    return Crop(close_up, frame.index, shows_object=True)


def _place_crop(item: ChangedObject, geometry: Geometry, capture: Capture) -> Crop | None:
    """The empty place: projected from the object's box in the other capture."""
    here = capture.video
    centroid = item.centroid_after if here == "before" else item.centroid_before
    extent = item.extent_after if here == "before" else item.extent_before
    if centroid is None or extent is None:
        return None
    corners = box_corners(centroid, extent) / geometry.unit
    seen = [(view, _projected(corners, view)) for view in geometry.of(here)]
    candidates = [
        (_visible_area(box, view), -view.index, view, box) for view, box in seen if box is not None
    ]
    if not candidates:
        return None
    _, _, view, box = max(candidates, key=lambda c: c[:2])
    frame = _frame(capture, view.index)
    if frame is None:
        return None
    scale_x, scale_y = (
        frame.image.shape[1] / view.lens.width,
        frame.image.shape[0] / view.lens.height,
    )
    box = (box[0] * scale_x, box[1] * scale_y, box[2] * scale_x, box[3] * scale_y)
    left, top, side = _window(box)
    close_up = _cut(frame.image, left, top, side)
    zoom = _SIDE / side
    x, y = (box[0] - left) * zoom, (box[1] - top) * zoom
    right, bottom = (box[2] - left) * zoom, (box[3] - top) * zoom
    _dashed(close_up, (x, y, right, bottom), KIND_COLOUR[item.kind])
    return Crop(close_up, frame.index, shows_object=False)


def box_corners(
    centre: tuple[float, float, float], extent: tuple[float, float, float]
) -> Float64[np.ndarray, "8 3"]:
    """Corners of an axis-aligned box; corner k takes bit i of k as its side along axis i."""
    signs = np.array([[(k >> axis & 1) - 0.5 for axis in range(3)] for k in range(8)])
    return np.asarray(centre, float) + signs * np.asarray(extent, float)


def _frame(capture: Capture, index: int) -> Frame | None:
    return next((frame for frame in capture.frames if frame.index == index), None)


def _projected(corners: Float64[np.ndarray, "8 3"], view: View) -> _Box | None:
    """Bounds of the box in the input picture; None if its centre is not in view."""
    centre, _ = project(corners.mean(0)[None], view.intrinsics, view.cam_from_world)
    xy, depth = project(corners, view.intrinsics, view.cam_from_world)
    if (depth <= 0).any() or not inside(centre, *view.shape).all():
        return None
    source = source_from_view(xy, view.lens, view.intrinsics)
    (left, top), (right, bottom) = source.min(0), source.max(0)
    return float(left), float(top), float(right), float(bottom)


def _visible_area(box: _Box, view: View) -> float:
    width = min(box[2], view.lens.width) - max(box[0], 0)
    height = min(box[3], view.lens.height) - max(box[1], 0)
    return max(width, 0) * max(height, 0)


def _window(box: _Box) -> tuple[float, float, float]:
    """Left, top and side of the square around a box, with its surroundings."""
    longer = max(box[2] - box[0], box[3] - box[1])
    side = max(longer * (1 + 2 * _MARGIN), 24.0)
    return (box[0] + box[2] - side) / 2, (box[1] + box[3] - side) / 2, side


def _cut(image: np.ndarray, left: float, top: float, side: float) -> np.ndarray:
    """A square window at the size of a close-up; grey where it leaves the picture."""
    zoom = _SIDE / side
    # The window's first pixel has its centre at 0.5; OpenCV counts from pixel centres.
    shift = np.array([[zoom, 0, (0.5 - left) * zoom - 0.5], [0, zoom, (0.5 - top) * zoom - 0.5]])
    if zoom < 1:  # average before point sampling, or fine texture would alias
        image = cv2.GaussianBlur(image, (0, 0), 0.4 / zoom)
    fill = (128, 128, 128) if image.ndim == 3 else 0
    return cv2.warpAffine(image, shift, (_SIDE, _SIDE), flags=cv2.INTER_LINEAR, borderValue=fill)


def _dashed(canvas: np.ndarray, box: _Box, colour: Colour) -> None:
    left, top, right, bottom = (round(value) for value in box)
    corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
    for width, ink in ((4, INK), (2, colour)):
        for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
            length = max(abs(x1 - x0), abs(y1 - y0), 1)
            for start in range(0, length, 12):
                ends = [start / length, min(start + 7, length) / length]
                a, b = [(round(x0 + t * (x1 - x0)), round(y0 + t * (y1 - y0))) for t in ends]
                cv2.line(canvas, a, b, ink, width, cv2.LINE_AA)
