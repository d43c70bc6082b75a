"""A made-up result with its evidence: boxes on a floor, one added, one removed, one moved.

Cameras, depth and masks are exact; the score maps are the truth plus noise. For the report's
tests and for looking at its pages, never for judging the method.
"""

from dataclasses import dataclass

import numpy as np
import open3d as o3d

from scenediff_classic.cameras import pixel_centres
from scenediff_classic.masks import bbox, encode
from scenediff_classic.result import RunInfo
from scenediff_classic.types import (
    Capture,
    ChangedObject,
    ChangeResult,
    Evidence,
    Frame,
    FrameInfo,
    Geometry,
    Kind,
    Lens,
    Match,
    ObjectView,
    PairScore,
    Placement,
    ScoreMaps,
    SparsePoints,
    Support,
    TermScores,
    Unregistered,
    Video,
    VideoInfo,
    View,
)

_THRESHOLD = 0.3
# Centre (x, y, z up), size, colour; the floor's top is z = 0.
_STAYS = [((-0.9, 0.7, 0.35), (0.5, 0.5, 0.7), (196, 160, 110))]
_ADDED = ((0.85, -0.55, 0.2), (0.4, 0.4, 0.4), (232, 190, 60))
_REMOVED = ((0.75, 0.8, 0.3), (0.35, 0.55, 0.6), (120, 90, 160))
_MOVED_FROM = ((-0.75, -0.65, 0.18), (0.45, 0.36, 0.36), (70, 140, 150))
_MOVED_TO = ((0.0, 0.1, 0.18), (0.45, 0.36, 0.36), (70, 140, 150))


@dataclass(frozen=True)
class Example:
    """Everything that the report is given."""

    result: ChangeResult
    evidence: Evidence
    before: Capture
    after: Capture
    run: RunInfo


def example(
    width: int = 96, height: int = 72, count: int = 3, *, changed: bool = True, unit: float = 1.0
) -> Example:
    """Two captures of `count` registered frames and one lost frame each.

    Parameters
    ----------
    unit : float
        World length of one unit of the evidence's geometry; the result stays in the world.
    """
    worlds: dict[Video, list] = {
        "before": [*_STAYS, _REMOVED, _MOVED_FROM],
        "after": [*_STAYS, _ADDED, _MOVED_TO] if changed else [*_STAYS, _REMOVED, _MOVED_FROM],
    }
    shots: dict[Video, list[_Shot]] = {
        video: [_shoot(worlds[video], video, i, count, width, height, unit) for i in range(count)]
        for video in worlds
    }
    captures: dict[Video, Capture] = {
        video: Capture(video, f"living room/{video}.mp4", (*(s.frame for s in taken), _lost(taken)))
        for video, taken in shots.items()
    }
    everything = [shot for taken in shots.values() for shot in taken]
    objects = _objects(shots["before"], shots["after"]) if changed else ()
    geometry = Geometry(
        tuple(shot.view for shot in everything),
        SparsePoints.none(),
        tuple(Unregistered(v, count, "too few matches with the other frames") for v in worlds),
        log=("Default features: 6 of 8 frames in one model, 0.61 px.",),
        unit=unit,
    )
    evidence = Evidence(
        geometry,
        tuple(_scores(shot, changed) for shot in everything),
        tuple((i, count + j) for i in range(count) for j in range(count) if abs(i - j) <= 1),
    )
    result = ChangeResult(
        _info(captures["before"], count),
        _info(captures["after"], count),
        objects,
        _THRESHOLD if changed else None,
        scale=3.2,
        warnings=("1 of 4 frames before could not be registered.",),
        bridge=1234,
    )
    run = RunInfo(
        ("scenediff-classic", "detect", "before.mp4", "after.mp4", "-o", "out"),
        {"long_side": width, "geometry": {"type": "SfmGeometry", "seed": 0}},
        {"python": "3.11.9", "numpy": "2.4.0"},
        seed=0,
        stage_seconds={"read": 0.42, "geometry": 95.3, "regions": 3.1, "scores": 7.9},
        peak_memory_bytes=1_230_000_000,
    )
    return Example(result, evidence, captures["before"], captures["after"], run)


@dataclass(frozen=True)
class _Shot:
    frame: Frame
    view: View
    ids: np.ndarray
    boxes: list


def _shoot(
    boxes: list, video: Video, index: int, count: int, width: int, height: int, unit: float
) -> _Shot:
    angle = (0.9 if video == "before" else 1.0) * (index / max(count - 1, 1) - 0.5) - 1.5
    away, above = (3.1, 1.7) if video == "before" else (2.8, 2.0)
    centre = np.array([away * np.cos(angle), away * np.sin(angle), above])
    forward = -centre / np.linalg.norm(centre)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    intrinsics = np.array([[0.9 * width, 0, width / 2], [0, 0.9 * width, height / 2], [0, 0, 1]])
    xy = pixel_centres(height, width)
    in_cam = np.concatenate([xy, np.ones((height, width, 1))], -1) @ np.linalg.inv(intrinsics).T
    rays = in_cam @ rotation
    lines = np.concatenate([np.broadcast_to(centre, rays.shape), rays], -1)
    hit = _scene(boxes).cast_rays(o3d.core.Tensor.from_numpy(lines.astype(np.float32)))
    depth, ids = hit["t_hit"].numpy(), hit["geometry_ids"].numpy().astype(int)
    image = _shade(boxes, centre + rays * depth[..., None], hit["primitive_normals"].numpy(), ids)
    known = np.isfinite(depth)
    depth = np.where(known, depth, np.nan).astype(np.float32)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre / unit
    name = f"{video}#{index}"
    view = View(
        video, index, name, image, intrinsics, pose, depth / np.float32(unit),
        confidence=known.astype(np.float32), measured=known, ignore=np.zeros_like(known),
        lens=Lens(width, height, intrinsics, np.zeros(4)),
    )  # fmt: skip
    return _Shot(Frame(video, index, name, float(index), image, width, height), view, ids, boxes)


def _scene(boxes: list) -> o3d.t.geometry.RaycastingScene:
    scene = o3d.t.geometry.RaycastingScene()
    floor = ((0.0, 0.0, -0.05), (3.4, 3.4, 0.1), None)
    for centre, size, _ in [floor, *boxes]:
        mesh = o3d.t.geometry.TriangleMesh.create_box(*size)
        corner = np.array(centre) - np.array(size) / 2
        scene.add_triangles(mesh.translate(o3d.core.Tensor.from_numpy(corner)))
    return scene


def _shade(boxes: list, points: np.ndarray, normals: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Planks on the floor, stripes on the boxes, light from above."""
    points = np.nan_to_num(points, posinf=0, neginf=0)
    image = np.full((*ids.shape, 3), (206, 214, 222), float)
    plank = np.floor(points[..., 0] / 0.17) * 37.7
    grain = 0.86 + 0.1 * np.sin(plank) + 0.04 * np.sin(points[..., 1] * 23 + plank)
    image[ids == 0] = ((168, 132, 98) * grain[..., None])[ids == 0]
    stripes = np.where(np.floor(points.sum(-1) / 0.07) % 2 == 0, 1.0, 0.82)
    for number, (_, _, colour) in enumerate(boxes, start=1):
        image[ids == number] = (np.array(colour) * stripes[..., None])[ids == number]
    light = 0.62 + 0.38 * np.abs(normals @ np.array([0.35, -0.2, 0.91]))
    light[ids > len(boxes)] = 1.0
    return np.clip(image * light[..., None], 0, 255).astype(np.uint8)


def _lost(taken: list[_Shot]) -> Frame:
    first = taken[0].frame
    blank = np.full_like(first.image, 70)
    index = len(taken)
    return Frame(first.video, index, f"{first.video}#{index}", float(index), blank, *_size(first))


def _size(frame: Frame) -> tuple[int, int]:
    return frame.width, frame.height


def _info(capture: Capture, registered: int) -> VideoInfo:
    return VideoInfo(
        capture.source,
        tuple(
            FrameInfo(
                f.index, f.name, f.time_s, f.width, f.height, f.index < registered,
                None if f.index < registered else "too few matches with the other frames",
                Placement(
                    0.85 - 0.33 * f.index, 420 - 150 * f.index, 130, 0.75, 0.61,
                    (0.93, None)[f.index % 2],
                ) if f.index < registered else None,
            )
            for f in capture.frames
        ),
    )  # fmt: skip


def _objects(before: list[_Shot], after: list[_Shot]) -> tuple[ChangedObject, ...]:
    spots: list[tuple[Kind, tuple | None, tuple | None, float]] = [
        ("removed", _REMOVED, None, 0.91),
        ("added", None, _ADDED, 0.84),
        ("moved", _MOVED_FROM, _MOVED_TO, 0.57),
    ]
    return tuple(
        ChangedObject(
            number, kind, confidence,
            None if was is None else was[0], None if now is None else now[0],
            None if was is None else was[1], None if now is None else now[1],
            TermScores(0.31, 0.42 - 0.1 * number, 0.22),
            (*_views(before, was, confidence), *_views(after, now, confidence)),
            Support(9, 7, (PairScore("before" if was else "after", 0, 1, 0.61),)),
            Match(0.97 if was and now else 0.41, 0.93, 1.1, 2.5),
        )
        for number, (kind, was, now, confidence) in enumerate(spots)
    )  # fmt: skip


def _views(taken: list[_Shot], box: tuple | None, confidence: float) -> tuple[ObjectView, ...]:
    seen = []
    for shot in taken:
        mask = shot.ids == shot.boxes.index(box) + 1 if box else np.zeros_like(shot.ids, bool)
        if mask.any():
            rle = encode(mask)
            seen.append(ObjectView(shot.frame.video, shot.frame.index, confidence, bbox(rle), rle))
    return tuple(seen)


def _scores(shot: _Shot, changed: bool) -> ScoreMaps:
    noise = np.random.default_rng(shot.frame.index).random((4, *shot.ids.shape), np.float32)
    differs = (shot.ids > 1) & (shot.ids <= len(shot.boxes)) & changed
    terms = [0.5 * differs + 0.08 * noise[i] for i in range(4)]
    for term in terms:
        term[shot.ids > len(shot.boxes)] = np.nan
    return ScoreMaps(*(term.astype(np.float32) for term in terms))
