"""Hand-held walks round the table: where the camera is at each second."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from data_tools.synthetic_pairs.canvas import Rng
from data_tools.synthetic_pairs.room import Room
from data_tools.synthetic_pairs.tracer import Camera

WALL_GAP = 0.35
"""Metres that a camera keeps from the walls."""


@dataclass(frozen=True)
class Walk:
    """An arc about the table, in degrees from the normal of the back wall."""

    start: float
    stop: float
    radius: float
    """Metres from the point looked at, measured on the floor plan."""
    height: float
    aim: tuple[float, float, float]
    """The point looked at, as an offset from the centre of the table top, in metres."""


def plan_walks(rng: Rng, frames: int, *, close: bool) -> tuple[Walk, Walk]:
    """Two different arcs, in opposite directions, at different heights and distances.

    Neighbouring frames are 8 to 12 degrees apart: enough parallax for stereo, and few enough for
    descriptors to match.
    """
    sweep = float(np.clip(9.0 * (frames - 1), 50, 96))
    shift = rng.uniform(5, 10)
    radii = rng.uniform(1.5, 1.65), rng.uniform(1.7, 1.85)
    aims = (0.0, 0.05, 0.05), (0.05, 0.0, 0.0)
    if not close:
        radii = rng.uniform(2.25, 2.4), rng.uniform(2.5, 2.7)
        aims = (-0.1, 0.0, -0.2), (0.1, 0.1, -0.25)
    low, high = rng.uniform(1.3, 1.4), rng.uniform(1.6, 1.75)
    heights = (low, high) if rng.uniform() < 0.5 else (high, low)
    return (
        Walk(-sweep / 2 - shift, sweep / 2 - shift, radii[0], heights[0], aims[0]),
        Walk(sweep / 2 + shift, -sweep / 2 + shift, radii[1], heights[1], aims[1]),
    )


def cameras_along(
    walk: Walk, room: Room, rng: Rng, frames: int, width: int, height: int
) -> tuple[Camera, ...]:
    """One camera a sampled frame, with the tremble of a hand."""
    focal = width * rng.uniform(0.80, 0.90)
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    centre = np.add(room.table, walk.aim)
    cameras = []
    for degrees in np.linspace(walk.start, walk.stop, frames):
        angle = np.radians(degrees + rng.uniform(-1, 1))
        eye = centre + walk.radius * np.array([np.sin(angle), -np.cos(angle), 0.0])
        eye[0] = np.clip(eye[0], -room.width / 2 + WALL_GAP, room.width / 2 - WALL_GAP)
        eye[1] = max(eye[1], WALL_GAP)
        eye[2] = walk.height
        eye += rng.uniform(-0.03, 0.03, 3)
        aim = centre + rng.uniform(-0.05, 0.05, 3)
        pose = look_at(eye, aim, roll=np.radians(rng.uniform(-1.5, 1.5)))
        cameras.append(Camera(width, height, intrinsics, pose))
    return tuple(cameras)


def look_at(
    eye: Float64[np.ndarray, "3"], aim: Float64[np.ndarray, "3"], roll: float = 0.0
) -> Float64[np.ndarray, "4 4"]:
    """``cam_from_world`` of an upright camera at `eye` that looks at `aim` (z is up)."""
    ahead = (aim - eye) / np.linalg.norm(aim - eye)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    c, s = np.cos(roll), np.sin(roll)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([c * right + s * down, c * down - s * right, ahead])
    pose[:3, 3] = -(pose[:3, :3] * eye).sum(axis=1)
    return pose
