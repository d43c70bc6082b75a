"""What the 3D view shows: a coloured point cloud per capture, cameras, changed objects.

The page's script draws it on a plain canvas; nothing is loaded from a network.
"""

import base64
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Shaped, UInt8

from scenediff_classic.cameras import (
    camera_centre,
    inside,
    source_from_view,
    unproject,
    world_from_cam,
)
from scenediff_classic.masks import decode
from scenediff_classic.report.crops import box_corners
from scenediff_classic.report.palette import KIND_COLOUR, VIDEO_COLOUR, css
from scenediff_classic.types import (
    VIDEOS,
    ChangedObject,
    ChangeResult,
    Geometry,
    Kind,
    Video,
    View,
)

_POINTS = 50_000
"""Points of one capture: enough for a dense look, and 0.7 MB of page."""
_CONFIDENT = 0.3
_TINT = 0.65
"""How strongly a changed object's points take on the colour of its kind."""
_SIZE_STEPS = 2048
"""Steps of a patch's width in one scene radius: 8 bits reach an eighth of it."""
_CAMERA = 0.055
"""Depth of a drawn camera, relative to the radius of the scene."""


@dataclass(frozen=True)
class _Cloud:
    xyz: Float64[np.ndarray, "n 3"]
    rgb: UInt8[np.ndarray, "n 3"]
    size: Float64[np.ndarray, "n"]
    """Width of the surface patch that a point stands for; 0 = unknown."""


def scene_json(result: ChangeResult, geometry: Geometry) -> str:
    """The 3D scene as JSON, safe inside a ``<script>`` element; see `scene_document`."""
    return script_json(scene_document(result, geometry))


def script_json(document: Any) -> str:
    """JSON that cannot end the ``<script>`` element around it."""
    return json.dumps(document, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def scene_document(
    result: ChangeResult,
    geometry: Geometry,
    points: int = _POINTS,
    answers: Mapping[str, ChangeResult] | None = None,
) -> dict[str, Any]:
    """The 3D scene as plain values.

    Coordinates are shifted and scaled to the scene's middle and radius, so that the script
    starts from a good distance whatever the unit of the world. Points are 16-bit integers over
    their cloud's bounding box (little endian, base64), their patches' widths 8-bit ones.

    Parameters
    ----------
    points : int
        At most so many of each capture.
    answers : mapping, optional
        Further results in the same world; their objects are listed by name under ``answers``.
    """
    clouds = {video: _cloud(result, geometry, video, points) for video in VIDEOS}
    centres = np.array([camera_centre(v.cam_from_world) for v in geometry.views]).reshape(-1, 3)
    everything = np.concatenate([clouds["before"].xyz, clouds["after"].xyz])
    frame = everything if len(everything) else centres
    middle = np.median(frame, axis=0) if len(frame) else np.zeros(3)
    around = np.r_[np.linalg.norm(frame - middle, axis=1), 0.0]
    radius = float(np.percentile(around, 90)) or 1.0

    def shown(points: Any) -> list[Any]:
        return np.round((np.asarray(points, float) - middle) / radius, 4).tolist()

    return {
        "up": _up(geometry),
        "from": shown(centres.mean(axis=0)) if len(centres) else [0, 0, -3],
        "sizeSteps": _SIZE_STEPS,
        "clouds": {video: _packed(clouds[video], middle, radius) for video in VIDEOS},
        "cameras": [_camera_json(view, middle, radius) for view in geometry.views],
        "trails": {video: _is_video(result, video) for video in VIDEOS},
        "colours": {video: css(VIDEO_COLOUR[video]) for video in VIDEOS},
        "objects": [_object_json(item, geometry.unit, shown) for item in result.objects],
        "answers": {
            name: [_object_json(item, geometry.unit, shown) for item in other.objects]
            for name, other in (answers or {}).items()
        },
    }


def _is_video(result: ChangeResult, video: Video) -> bool:
    """Photos of a folder need not follow each other: only a video's cameras are joined up."""
    info = result.before if video == "before" else result.after
    return any(frame.time_s is not None for frame in info.frames)


def _up(geometry: Geometry) -> list[float]:
    """The world's up: people hold cameras upright, so the mean of the cameras' up (-y)."""
    ups = [-world_from_cam(view.cam_from_world)[:3, 1] for view in geometry.views]
    mean = np.mean(ups, axis=0) if ups else np.array([0.0, -1.0, 0.0])
    length = float(np.linalg.norm(mean))
    return (mean / length if length > 1e-6 else np.array([0.0, -1.0, 0.0])).tolist()


def _cloud(result: ChangeResult, geometry: Geometry, video: Video, budget: int) -> _Cloud:
    """Measured pixels of a capture's views, thinned; changed ones tinted; else the SfM points."""
    views = geometry.of(video)
    parts = [_measured(view, result, budget // len(views)) for view in views]
    xyz = np.concatenate([np.zeros((0, 3)), *(part.xyz for part in parts)])
    rgb = np.concatenate([np.zeros((0, 3), np.uint8), *(part.rgb for part in parts)])
    size = np.concatenate([np.zeros(0), *(part.size for part in parts)])
    if len(xyz):
        return _Cloud(xyz, rgb, size)
    mine = [i for i, view in enumerate(geometry.views) if view.video == video]
    seen = geometry.points.observations
    points = np.unique(seen[np.isin(seen[:, 1], mine), 0])[:budget]
    return _Cloud(geometry.points.xyz[points], geometry.points.rgb[points], np.zeros(len(points)))


def _measured(view: View, result: ChangeResult, budget: int) -> _Cloud:
    good = view.measured & np.isfinite(view.depth) & (view.confidence > _CONFIDENT) & ~view.ignore
    rows, columns = np.nonzero(good)
    # Evenly spread ranks of a fixed shuffle: no grid pattern, and the same points every time.
    thinning = np.sqrt(max(len(rows) / max(budget, 1), 1.0))
    chosen = np.random.default_rng(0).permutation(len(rows))[:budget]
    rows, columns = rows[chosen], columns[chosen]
    rgb = view.image[rows, columns].astype(np.float32)
    for kind, changed in _changed(view, result, np.stack([columns, rows], axis=-1) + 0.5):
        rgb[changed] = (1 - _TINT) * rgb[changed] + _TINT * np.array(KIND_COLOUR[kind])
    xyz = unproject(view)[rows, columns].astype(np.float64)
    patch = view.depth[rows, columns].astype(np.float64) / view.intrinsics[0, 0] * thinning
    return _Cloud(xyz, np.rint(rgb).astype(np.uint8), patch)


def _changed(
    view: View, result: ChangeResult, xy: Float64[np.ndarray, "n 2"]
) -> Iterator[tuple[Kind, Bool[np.ndarray, "n"]]]:
    """Per object in the view: its kind, and which positions of the working picture it covers."""
    source = source_from_view(xy, view.lens, view.intrinsics)
    on_picture = inside(source, view.lens.height, view.lens.width)
    column, row = np.where(on_picture[:, None], source, 0).astype(int).T
    for item in result.objects:
        for seen in item.views:
            if (seen.video, seen.frame) == view.key:
                yield item.kind, decode(seen.mask)[row, column] & on_picture


def _packed(cloud: _Cloud, middle: np.ndarray, radius: float) -> dict[str, Any]:
    xyz = (cloud.xyz - middle) / radius
    # Single wild points would stretch the box and coarsen every other point.
    xyz_kept = np.all(np.abs(xyz) < 8, axis=1)
    xyz, rgb = xyz[xyz_kept], cloud.rgb[xyz_kept]
    size = np.clip(np.rint(cloud.size[xyz_kept] / radius * _SIZE_STEPS), 0, 255)
    low = xyz.min(axis=0) if len(xyz) else np.zeros(3)
    span = np.maximum(xyz.max(axis=0) - low, 1e-9) if len(xyz) else np.ones(3)
    steps = np.rint((xyz - low) / span * 65535)
    return {
        "count": len(xyz),
        "low": low.tolist(),
        "span": span.tolist(),
        "xyz": _base64(steps.astype("<u2")),
        "rgb": _base64(rgb),
        "size": _base64(size.astype(np.uint8)),
    }


def _base64(values: Shaped[np.ndarray, "..."]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode("ascii")


def _camera_json(view: View, middle: np.ndarray, radius: float) -> dict[str, Any]:
    """A pyramid: its tip at the camera's centre, its base the picture at a fixed depth."""
    height, width = view.shape
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], float)
    rays = np.linalg.solve(view.intrinsics, corners.T).T * _CAMERA * radius
    to_world = world_from_cam(view.cam_from_world)
    base = rays @ to_world[:3, :3].T + to_world[:3, 3]
    shape = np.vstack([to_world[:3, 3], base])
    return {
        "video": view.video,
        "index": view.index,
        "name": view.name,
        "shape": np.round((shape - middle) / radius, 4).tolist(),
    }


def _object_json(item: ChangedObject, unit: float, shown: Any) -> dict[str, Any]:
    boxes = {
        "before": (item.centroid_before, item.extent_before),
        "after": (item.centroid_after, item.extent_after),
    }
    return {
        "id": item.id,
        "kind": item.kind,
        "colour": css(KIND_COLOUR[item.kind]),
        "boxes": {
            video: shown(box_corners(centre, extent) / unit)
            for video, (centre, extent) in boxes.items()
            if centre is not None and extent is not None
        },
    }
