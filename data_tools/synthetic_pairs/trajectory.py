"""Hand-held walks round the table: where the camera is at each second."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation, Slerp

from data_tools.synthetic_pairs.canvas import Rng
from data_tools.synthetic_pairs.room import Room
from data_tools.synthetic_pairs.tracer import Camera

WALL_GAP = 0.35
"""Metres that a camera keeps from the walls."""

Trajectories = Literal["diverging", "interpolating"]
"""Where the after-cameras are: on another arc, or between those of the before-walk."""


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


def cameras_between(walk: Sequence[Camera], like: Sequence[Camera], rng: Rng) -> tuple[Camera, ...]:
    """Cameras inside a walk: each between two neighbours of it, held by a hand that trembles less.

    Parameters
    ----------
    walk : sequence of Camera
        At least two.
    like : sequence of Camera
        How many there shall be, and their intrinsics; they run along the walk the other way.
    """
    poses = np.stack([c.cam_from_world for c in walk])
    eyes = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    turns = Slerp(np.arange(len(walk)), Rotation.from_matrix(poses[:, :3, :3]))
    cameras = []
    for camera, at in zip(like, np.linspace(len(walk) - 1.5, 0.5, len(like)), strict=True):
        eye = [np.interp(at, np.arange(len(walk)), axis) for axis in eyes.T]
        eye = np.array(eye) + rng.uniform(-0.01, 0.01, 3)
        pose = np.eye(4)
        pose[:3, :3] = turns(at).as_matrix()
        pose[:3, 3] = -(pose[:3, :3] * eye).sum(axis=1)
        cameras.append(Camera(camera.width, camera.height, camera.intrinsics, pose))
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
