"""Pairs of visits of the ObChange rooms, with known geometry and what changed between them.

``python -m data_tools.benchmarks.obchange ROOT ROOM FIRST SECOND -o OUT`` writes two visits as
``before/``, ``after/``, ``geometry.npz`` (a *known* geometry) and ``boxes.json``.
"""

import json
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from jaxtyping import Float64
from PIL import Image

from data_tools.benchmarks.obchange_visits import (
    INTRINSICS,
    Box,
    RobotView,
    picture_name,
    read_colour,
    read_depth,
    read_visit,
)
from scenediff_classic.cameras import world_from_cam
from scenediff_classic.errors import InputError, OutputError, SceneDiffError
from scenediff_classic.types import VIDEOS, Kind, Video

MOVED_BY = 0.12
"""Metres: objects that stayed seem to shift by up to 0.09 (localisation, coarse depth, boxes)."""


@dataclass(frozen=True)
class ChangedBox:
    """The hand-drawn box of an object that is not the same in the other visit."""

    name: str
    kind: Kind
    video: Video
    frame: int
    """Position among the visit's views."""
    box: Box


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


def write_visits(
    root: Path, room: str, first: int, second: int, out: Path, chosen: Sequence[int] = ()
) -> None:
    """Write two visits as folders of pictures, known geometry and boxes of what changed.

    Parameters
    ----------
    chosen : sequence of int
        Numbers of the views to use; all of them if left out.

    Raises
    ------
    InputError
        The recordings cannot be read, or lack a chosen view.
    OutputError
        `out` exists and is not empty, or cannot be written.
    """
    visits = read_visit(root, room, first), read_visit(root, room, second)
    before, after = (
        _chosen(v, chosen, room, n) for v, n in zip(visits, (first, second), strict=True)
    )
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
        # told by all views: one alone may see too little of a thing to place it
        changed = changed_boxes(*visits)
        kept = [
            *_among(changed, "before", visits[0], before),
            *_among(changed, "after", visits[1], after),
        ]
        boxes = [asdict(item) for item in kept]
        text = json.dumps({"boxes": boxes}, indent=1) + "\n"
        (unfinished / "boxes.json").write_text(text, encoding="utf-8")
        unfinished.rename(out)
    except OSError as error:
        raise OutputError(f"Cannot write {out}: {error.strerror or error}.") from error
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _chosen(
    views: Sequence[RobotView], numbers: Sequence[int], room: str, visit: int
) -> tuple[RobotView, ...]:
    missing = set(numbers) - {view.view for view in views}
    if missing:
        raise InputError(f"{room} {visit} has no view {', '.join(map(str, sorted(missing)))}.")
    return tuple(view for view in views if not numbers or view.view in numbers)


def _among(
    changed: Sequence[ChangedBox],
    video: Video,
    views: Sequence[RobotView],
    used: Sequence[RobotView],
) -> Iterator[ChangedBox]:
    """The boxes of a visit that lie in the views used, with frames counted among these."""
    position = {view.view: number for number, view in enumerate(used)}
    for item in changed:
        if item.video == video and views[item.frame].view in position:
            yield replace(item, frame=position[views[item.frame].view])


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
    views: tuple[int, ...] = ()
    """Numbers of the views to use; all of them if left out."""


def main(arguments: list[str] | None = None) -> int:
    """Write what the arguments ask for; returns the exit code."""
    options = tyro.cli(Options, args=arguments, prog="python -m data_tools.benchmarks.obchange")
    try:
        write_visits(
            options.root, options.room, options.first, options.second, options.out, options.views
        )
    except SceneDiffError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
