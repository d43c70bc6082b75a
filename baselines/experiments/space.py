"""A pair in space: the 3D view of the page, and cameras and objects from above."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64
from matplotlib.figure import Figure

from baselines.experiments.pair_pictures import Answer, PairPictures, letter_of
from baselines.experiments.plots import Place, trajectory_plot
from scenediff_classic.cameras import camera_centre, unproject, world_from_cam
from scenediff_classic.errors import SceneDiffError
from scenediff_classic.geometry.store import load_geometry
from scenediff_classic.report.viewer import scene_document
from scenediff_classic.types import VIDEOS, ChangedObject, ChangeResult, Geometry, Video

_POINTS = 14_000
"""Of a capture in the 3D view: a third of a megabyte of page for a pair."""
_FINER = 1.6
"""Views overlap: patches may be that much smaller than their share of one view."""
_SAME = 1e-3
"""Relative to the spread of the cameras: nearer than that, two answers share one world."""


def geometry_of(pictures: PairPictures, answer: Answer) -> Geometry | None:
    """The cameras and depth of an answer; None where they are gone."""
    if answer.cell.output is None or answer.result is None:
        return None
    try:
        folder = answer.cell.output / "geometry"
        return load_geometry(folder, pictures.captures["before"], pictures.captures["after"])
    except SceneDiffError:
        return None


def first_geometry(pictures: PairPictures) -> tuple[Answer, Geometry] | None:
    """The first answer that has cameras."""
    for answer in pictures.answers:
        geometry = geometry_of(pictures, answer)
        if geometry is not None and geometry.views:
            return answer, geometry
    return None


def scene_of(pictures: PairPictures, answer: Answer, geometry: Geometry) -> dict[str, Any] | None:
    """Points and cameras of one answer, and the boxes of all that share its world.

    Boxes are listed by answer under ``answers``; what matches a true object carries its letter.
    """
    if answer.result is None:
        return None
    sharing = [
        other for other in pictures.answers
        if other.result is not None and (other is answer or _same_world(answer, other))
    ]  # fmt: skip
    results = {other.title: other.result for other in sharing if other.result is not None}
    scene = scene_document(_without_objects(answer.result), geometry, _POINTS, results)
    for other in sharing:
        names = _names(other)
        for box in scene["answers"][other.title]:
            box["name"] = names.get(box["id"], "?")
    return scene | {"sizeSteps": _FINER * scene["sizeSteps"]}


def _without_objects(result: ChangeResult) -> ChangeResult:
    """Untinted points: each answer would tint others."""
    return replace(result, objects=())


def _names(answer: Answer) -> dict[int, str]:
    return {
        thing.id: letter_of(answer.found[i]) if i in answer.found else "?"
        for i, thing in enumerate(answer.things)
    }


def _same_world(first: Answer, second: Answer) -> bool:
    """Whether two answers stand on the same cameras."""
    poses = [_poses(first), _poses(second)]
    shared = poses[0].keys() & poses[1].keys()
    if not shared:
        return False
    stacks = [np.stack([camera_centre(p[key]) for key in sorted(shared)]) for p in poses]
    spread = float(np.linalg.norm(stacks[0] - stacks[0].mean(axis=0), axis=1).max()) or 1.0
    return float(np.abs(stacks[0] - stacks[1]).max()) < _SAME * spread


def _poses(answer: Answer) -> dict[str, np.ndarray]:
    """Camera poses as the depth files hold them, by file name."""
    folder = answer.cell.output / "geometry" / "depth" if answer.cell.output else None
    found: dict[str, np.ndarray] = {}
    for path in sorted(folder.glob("*.npz")) if folder else ():
        try:
            with np.load(path, allow_pickle=False) as stored:
                found[path.name] = stored["cam_from_world"]
        except (OSError, ValueError, KeyError):
            continue
    return found


def plan_of(answer: Answer, geometry: Geometry) -> Figure:
    """The trajectory plot of a pair."""
    ups = np.mean([-world_from_cam(v.cam_from_world)[:3, 1] for v in geometry.views], axis=0)
    axes = _plane(ups)
    centres: dict[Video, Float64[np.ndarray, "n 2"]] = {}
    looks: dict[Video, Float64[np.ndarray, "n 2"]] = {}
    for video in VIDEOS:
        poses = [world_from_cam(v.cam_from_world) for v in geometry.of(video)]
        centres[video] = np.array([p[:3, 3] for p in poses]).reshape(-1, 3) @ axes.T
        flat = np.array([p[:3, 2] for p in poses]).reshape(-1, 3) @ axes.T
        looks[video] = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    objects = answer.result.objects if answer.result else ()
    names = _names(answer)
    places = [p for i in objects if (p := _place(i, names[i.id], geometry.unit, axes)) is not None]
    return trajectory_plot(centres, looks, _points(geometry) @ axes.T, places)


def _plane(up: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "2 3"]:
    """Two directions that span the ground."""
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    helper = np.array([1.0, 0, 0]) if abs(up[0]) < 0.8 else np.array([0, 1.0, 0])
    east = np.cross(helper, up)
    east /= np.linalg.norm(east)
    return np.stack([east, np.cross(up, east)])


def _place(item: ChangedObject, name: str, unit: float, axes: np.ndarray) -> Place | None:
    known: Mapping[Video, Any] = {"before": item.centroid_before, "after": item.centroid_after}
    at: dict[Video, np.ndarray] = {
        v: axes @ (np.asarray(c, float) / unit) for v, c in known.items() if c is not None
    }
    return Place(name, item.kind, at) if at else None


def _points(geometry: Geometry) -> Float64[np.ndarray, "n 3"]:
    """Every few measured pixels of every view."""
    parts: Sequence[np.ndarray] = [
        unproject(v)[::4, ::4][(v.measured & (v.confidence > 0.3))[::4, ::4]]
        for v in geometry.views
    ]
    found = np.concatenate([np.zeros((0, 3)), *parts])
    return found[np.isfinite(found).all(axis=1)]
