"""Reader of the ObChange room recordings: robot RGB-D views of a room at several visits.

Folder layout: ``annotations.json`` with one record an image (room, visit, view, colour and depth
file, 4x4 ``cam_to_map`` in metres, hand-drawn boxes of all movable objects), and the pictures.

``python -m data_tools.benchmarks.obchange ROOT ROOM FIRST SECOND -o OUT`` writes two visits as
``before/``, ``after/``, ``geometry.npz`` (a *known* geometry) and ``boxes.json``.
"""

import json
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import tyro
from jaxtyping import Float32, Float64, UInt8
from PIL import Image

from scenediff_classic.cameras import world_from_cam
from scenediff_classic.errors import InputError, OutputError, SceneDiffError
from scenediff_classic.types import VIDEOS, Capture, Frame, Kind, Video

FOCAL_PX = 554.0
INTRINSICS = np.array([[FOCAL_PX, 0, 320.0], [0, FOCAL_PX, 240.0], [0, 0, 1]])
"""Of all pictures (640 x 480); found by fitting plane heights, good to a few percent."""
METRES_PER_LEVEL = 10 / 255
"""Depth pictures have 8 bits: level v means (v + 0.5) of these, and 0 means no reading."""
MOVED_BY = 0.12
"""Metres: objects that stayed seem to shift by up to 0.09 (localisation, coarse depth, boxes)."""

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


@dataclass(frozen=True)
class ChangedBox:
    """The hand-drawn box of an object that is not the same in the other visit."""

    name: str
    kind: Kind
    video: Video
    frame: int
    """Position among the visit's views."""
    box: Box


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
    """z-depth in metres, registered to colour; NaN where there is no reading."""
    levels = cv2.imread(str(view.depth_path), cv2.IMREAD_UNCHANGED)
    if levels is None or levels.ndim != 2 or levels.dtype != np.uint8:
        raise InputError(f"{view.depth_path} cannot be read as an 8-bit depth picture.")
    depth = (levels.astype(np.float32) + np.float32(0.5)) * np.float32(METRES_PER_LEVEL)
    return np.where(levels > 0, depth, np.float32(np.nan))


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


def changed_boxes(
    before: Sequence[RobotView], after: Sequence[RobotView]
) -> tuple[ChangedBox, ...]:
    """Boxes of the objects whose name or place differs between two visits.

    An object that both visits show counts as moved if its place in the room, from depth, differs
    by more than `MOVED_BY`. One without any depth in a visit counts as unmoved.
    """
    visits: dict[Video, Sequence[RobotView]] = {"before": before, "after": after}
    places = {video: _places(views) for video, views in visits.items()}
    names = {video: {o.name for v in views for o in v.objects} for video, views in visits.items()}
    kinds: dict[str, Kind] = {}
    for name in names["before"] | names["after"]:
        if name not in names["after"]:
            kinds[name] = "removed"
        elif name not in names["before"]:
            kinds[name] = "added"
        elif all(name in places[video] for video in VIDEOS):
            shift = places["after"][name] - places["before"][name]
            if np.linalg.norm(shift) > MOVED_BY:
                kinds[name] = "moved"
    return tuple(
        ChangedBox(item.name, kinds[item.name], video, frame, item.box)
        for video, views in visits.items()
        for frame, view in enumerate(views)
        for item in view.objects
        if item.name in kinds
    )


def write_known_geometry(
    before: Sequence[RobotView], after: Sequence[RobotView], path: Path
) -> None:
    """Cameras and depth of two visits as an ``.npz`` that the *known* geometry source reads.

    Poses are the robot's own and are not refined.
    """
    views = [*before, *after]
    depth = np.stack([read_depth(view) for view in views])
    np.savez_compressed(
        path,
        intrinsics=np.stack([INTRINSICS] * len(views)),
        cam_from_world=np.stack([view.cam_from_world for view in views]),
        depth=depth,
        confidence=np.isfinite(depth).astype(np.float16),
        video=np.repeat(np.array([0, 1], np.uint8), [len(before), len(after)]),
        index=np.array([*range(len(before)), *range(len(after))], np.int32),
    )


def write_visits(root: Path, room: str, first: int, second: int, out: Path) -> None:
    """Write two visits as folders of pictures, known geometry and boxes of what changed.

    Raises
    ------
    InputError
        The recordings cannot be read.
    OutputError
        `out` exists and is not empty, or cannot be written.
    """
    before, after = read_visit(root, room, first), read_visit(root, room, second)
    unfinished = out.with_name(f".{out.name}.part")
    try:
        if out.exists() and any(out.iterdir()):
            raise OutputError(f"{out} is not empty: give another folder with -o.")
        shutil.rmtree(unfinished, ignore_errors=True)
        for video, views in zip(VIDEOS, (before, after), strict=True):
            (unfinished / video).mkdir(parents=True, exist_ok=True)
            for view in views:
                picture = Image.fromarray(read_colour(view))
                picture.save(unfinished / video / picture_name(view))
        write_known_geometry(before, after, unfinished / "geometry.npz")
        boxes = [asdict(item) for item in changed_boxes(before, after)]
        text = json.dumps({"boxes": boxes}, indent=1) + "\n"
        (unfinished / "boxes.json").write_text(text, encoding="utf-8")
        unfinished.rename(out)
    except OSError as error:
        raise OutputError(f"Cannot write {out}: {error.strerror or error}.") from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


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


def _places(views: Sequence[RobotView]) -> dict[str, Float64[np.ndarray, "3"]]:
    """Where each object is in the room: the median over the views that show it."""
    found: dict[str, list[np.ndarray]] = {}
    for view in views:
        for name, point in _points(view):
            found.setdefault(name, []).append(point)
    return {name: np.median(points, axis=0) for name, points in found.items()}


def _points(view: RobotView) -> Iterator[tuple[str, Float64[np.ndarray, "3"]]]:
    if not view.objects:
        return
    depth = read_depth(view)
    to_world = world_from_cam(view.cam_from_world)
    for item in view.objects:
        x0, y0, x1, y1 = item.box
        # The middle half of the box: less of the background.
        rows = slice(int(0.75 * y0 + 0.25 * y1), int(np.ceil(0.25 * y0 + 0.75 * y1)))
        columns = slice(int(0.75 * x0 + 0.25 * x1), int(np.ceil(0.25 * x0 + 0.75 * x1)))
        inner = depth[rows, columns]
        if not np.isfinite(inner).any():
            continue
        z = float(np.nanmedian(inner))
        centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 1.0])
        in_camera = np.linalg.solve(INTRINSICS, centre) * z
        yield item.name, to_world[:3, :3] @ in_camera + to_world[:3, 3]


@dataclass(frozen=True)
class Options:
    """Write two visits of a room as a pair with known geometry."""

    root: tyro.conf.Positional[Path]
    """Folder that holds annotations.json."""
    room: tyro.conf.Positional[str]
    """Kitchen or SmallRoom."""
    first: tyro.conf.Positional[int]
    """Visit that becomes `before`."""
    second: tyro.conf.Positional[int]
    """Visit that becomes `after`."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """New folder for the pair."""


def main(arguments: list[str] | None = None) -> int:
    """Write what the arguments ask for; returns the exit code."""
    options = tyro.cli(Options, args=arguments, prog="python -m data_tools.benchmarks.obchange")
    try:
        write_visits(options.root, options.room, options.first, options.second, options.out)
    except SceneDiffError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
