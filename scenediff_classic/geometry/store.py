"""A finished geometry on disk: a COLMAP model anyone can open, and exact arrays for us.

Layout of the folder::

    geometry.json              unregistered frames, warnings, log, unit, trust in each camera
    sparse/                    COLMAP model of the *input* pictures (OpenCV cameras)
    points.npz                 sparse points and their observations
    depth/before_00000.npz     depth, confidence, measured, ignore, cameras of one view
"""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from scenediff_classic.cameras import undistort
from scenediff_classic.errors import InputError, OutputError
from scenediff_classic.geometry.checked import read_npz
from scenediff_classic.geometry.registration.colmap.models import write_model
from scenediff_classic.geometry.registration.sparse_model import PosedPicture, SparseModel
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.types import (
    Capture,
    Frame,
    Geometry,
    Lens,
    Placement,
    SparsePoints,
    Unregistered,
    View,
)


def save_geometry(geometry: Geometry, folder: Path) -> None:
    """Write a geometry so that it is either all there or not at all.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    partial = folder.with_name(folder.name + ".part")
    with _writing(folder):
        shutil.rmtree(partial, ignore_errors=True)
        (partial / "depth").mkdir(parents=True)
        for view in geometry.views:
            _save_view(view, partial / "depth" / f"{_stem(view)}.npz")
        write_model(_sparse_model(geometry), partial / "sparse")
        points = geometry.points
        np.savez_compressed(
            partial / "points.npz",
            xyz=points.xyz,
            rgb=points.rgb,
            observations=points.observations,
        )
        content = {
            "views": [[view.video, view.index] for view in geometry.views],
            "unregistered": [asdict(frame) for frame in geometry.unregistered],
            "warnings": geometry.warnings,
            "log": geometry.log,
            "unit": geometry.unit,
            "bridge": geometry.bridge,
            "placements": [v.placement and asdict(v.placement) for v in geometry.views],
        }
        text = json.dumps(content, indent=1)
        (partial / "geometry.json").write_text(text, encoding="utf-8")
        shutil.rmtree(folder, ignore_errors=True)
        os.replace(partial, folder)


def load_geometry(folder: Path, before: Capture, after: Capture) -> Geometry:
    """Read what `save_geometry` wrote; pictures are undistorted anew from the captures.

    Raises
    ------
    InputError
        If the folder is incomplete or belongs to other captures.
    """
    try:
        content = json.loads((folder / "geometry.json").read_text(encoding="utf-8"))
        keys = [(video, int(index)) for video, index in content["views"]]
        unregistered = tuple(Unregistered(**frame) for frame in content["unregistered"])
        warnings, log, unit = content["warnings"], content["log"], float(content["unit"])
        bridge = content.get("bridge")  # earlier versions did not write these two
        checks = [p and Placement(**p) for p in content.get("placements", [None] * len(keys))]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder} does not hold a finished geometry.") from error
    frames = {(f.video, f.index): f for f in (*before.frames, *after.frames)}
    if set(keys) | {(u.video, u.index) for u in unregistered} != set(frames):
        raise InputError(f"{folder} belongs to other captures: their frames differ.")
    views = tuple(
        replace(
            _load_view(frames[key], folder / "depth" / f"{key[0]}_{key[1]:05d}.npz"),
            placement=check,
        )
        for key, check in zip(keys, checks, strict=True)
    )
    arrays = read_npz(folder / "points.npz")
    points = SparsePoints(arrays["xyz"], arrays["rgb"], arrays["observations"])
    return Geometry(views, points, unregistered, tuple(warnings), tuple(log), unit, bridge)


@dataclass(frozen=True)
class SavedGeometry:
    """The geometry of a finished run, used again."""

    path: Path
    """The folder of the run, or its ``geometry`` folder."""

    @staticmethod
    def found_in(path: Path) -> bool:
        """True if there is a finished geometry in the folder."""
        return any((f / "geometry.json").is_file() for f in (path, path / "geometry"))

    def __call__(
        self, before: Capture, after: Capture, workspace: Path, progress: Progress = silent
    ) -> Geometry:
        """Load it for the same captures."""
        inner = self.path / "geometry"
        return load_geometry(inner if inner.is_dir() else self.path, before, after)


def _stem(view: View) -> str:
    return f"{view.video}_{view.index:05d}"


def _save_view(view: View, path: Path) -> None:
    np.savez_compressed(
        path,
        depth=view.depth,
        confidence=view.confidence,
        measured=view.measured,
        ignore=view.ignore,
        intrinsics=view.intrinsics,
        cam_from_world=view.cam_from_world,
        lens_size=np.array([view.lens.width, view.lens.height]),
        lens_intrinsics=view.lens.intrinsics,
        lens_distortion=view.lens.distortion,
    )


def _load_view(frame: Frame, path: Path) -> View:
    arrays = read_npz(path)
    try:
        width, height = (int(v) for v in arrays["lens_size"])
        lens = Lens(width, height, arrays["lens_intrinsics"], arrays["lens_distortion"])
        if (width, height) != (frame.width, frame.height):
            raise InputError(f"{path} belongs to a picture of {width}x{height}, not {frame.name}.")
        shape = arrays["depth"].shape
        image, _ = undistort(frame.image, lens, arrays["intrinsics"], *shape)
        return View(
            video=frame.video,
            index=frame.index,
            name=frame.name,
            image=image,
            intrinsics=arrays["intrinsics"],
            cam_from_world=arrays["cam_from_world"],
            depth=arrays["depth"],
            confidence=arrays["confidence"],
            measured=arrays["measured"],
            ignore=arrays["ignore"],
            lens=lens,
        )
    except KeyError as error:
        raise InputError(f"{path} lacks the array {error}.") from error


def _sparse_model(geometry: Geometry) -> SparseModel:
    pictures = tuple(
        PosedPicture(f"{view.video}/{view.name}", view.lens, view.cam_from_world)
        for view in geometry.views
    )
    return SparseModel(pictures, geometry.points, float("nan"))


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise OutputError(f"{folder} cannot be written: {error.strerror or error}.") from error
