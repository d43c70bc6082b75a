"""Reader of the ObChange room recordings: robot RGB-D views of a room at several visits.

Folder layout: ``annotations.json`` with one record an image (room, visit, view, colour and depth
file, 4x4 ``cam_to_map`` in metres, hand-drawn boxes of all movable objects), and the pictures.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8
from PIL import Image

from data_tools.benchmarks.depth_levels import between_levels
from scenediff_classic.cameras import world_from_cam
from scenediff_classic.errors import InputError
from scenediff_classic.types import Capture, Frame, Video

FOCAL_PX = 554.0
INTRINSICS = np.array([[FOCAL_PX, 0, 320.0], [0, FOCAL_PX, 240.0], [0, 0, 1]])
"""Of all pictures (640 x 480); found by fitting plane heights, good to a few percent."""
METRES_PER_LEVEL = 10 / 255
"""Depth pictures have 8 bits: level v means v to v + 1 of these, and 0 means no reading."""
Box = tuple[float, float, float, float]
"""x0, y0, x1, y1 in pixels."""


@dataclass(frozen=True)
class LabelledBox:
    """A movable object in one picture."""

    name: str
    box: Box


@dataclass(frozen=True, eq=False)
class RobotView:
    """One picture of a visit."""

    view: int
    colour_path: Path
    depth_path: Path
    cam_from_world: Float64[np.ndarray, "4 4"]
    """From the robot's localisation: several centimetres off between visits."""
    objects: tuple[LabelledBox, ...]


def read_visit(root: Path, room: str, visit: int) -> tuple[RobotView, ...]:
    """The views of one visit, by view number.

    Parameters
    ----------
    room : str
        As in the annotations: ``Kitchen`` or ``SmallRoom``.
    visit : int
        From 1.

    Raises
    ------
    InputError
        The annotations are missing or damaged, or have no such visit.
    """
    path = root / "annotations.json"
    try:
        records = json.loads(path.read_text(encoding="utf-8"))["images"]
        views = [_view(root, r) for r in records if (r["room"], r["visit"]) == (room, visit)]
        known = sorted({(str(r["room"]), int(r["visit"])) for r in records})
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}).") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} is not an annotation of ObChange recordings.") from error
    if not views:
        there = ", ".join(f"{name} {number}" for name, number in known) or "none"
        raise InputError(f"{path} has no visit {room} {visit}; it has: {there}.")
    return tuple(sorted(views, key=lambda v: v.view))


def read_colour(view: RobotView) -> UInt8[np.ndarray, "h w 3"]:
    """The picture in RGB; the files carry an alpha channel without meaning."""
    try:
        with Image.open(view.colour_path) as picture:
            return np.asarray(picture.convert("RGB"))
    except (OSError, SyntaxError) as error:
        raise InputError(f"{view.colour_path} cannot be read as a picture.") from error


def read_depth(view: RobotView) -> Float32[np.ndarray, "h w"]:
    """z-depth in metres, registered to colour; NaN where there is no reading.

    Between the levels of the file it is smooth: the stairs of 4 cm would each be taken for an edge.
    """
    levels = cv2.imread(str(view.depth_path), cv2.IMREAD_UNCHANGED)
    if levels is None or levels.ndim != 2 or levels.dtype != np.uint8:
        raise InputError(f"{view.depth_path} cannot be read as an 8-bit depth picture.")
    return (between_levels(levels) * METRES_PER_LEVEL).astype(np.float32)


def read_capture(views: Sequence[RobotView], video: Video) -> Capture:
    """The colour pictures of a visit as one capture."""
    frames = []
    for index, view in enumerate(views):
        image = read_colour(view)
        height, width = image.shape[:2]
        frames.append(Frame(video, index, picture_name(view), None, image, width, height, FOCAL_PX))
    return Capture(video, str(views[0].colour_path.parent), tuple(frames))


def picture_name(view: RobotView) -> str:
    """Name of a view's picture in what `write_visits` writes."""
    return f"view_{view.view:02d}.png"


def _view(root: Path, record: dict[str, Any]) -> RobotView:
    pose = np.asarray(record["cam_to_map"], np.float64)
    if pose.shape != (4, 4):
        raise ValueError("a pose must be 4x4")
    objects = tuple(LabelledBox(str(o["name"]), _box(o["bbox_xyxy"])) for o in record["objects"])
    return RobotView(
        int(record["view"]),
        root / str(record["rgb"]),
        root / str(record["depth"]),
        world_from_cam(pose),
        objects,
    )


def _box(values: Sequence[float]) -> Box:
    x0, y0, x1, y1 = (float(v) for v in values)
    return x0, y0, x1, y1
