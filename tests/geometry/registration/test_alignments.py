"""Two captures' own models: every rigid motion between them is found, and the room is told."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scenediff_classic.cameras import camera_centre, project
from scenediff_classic.geometry.registration.alignments import (
    AMBIGUOUS,
    alignments,
    ground_share,
    looks_of,
)
from scenediff_classic.geometry.registration.joining import join
from scenediff_classic.geometry.registration.sparse_model import PosedPicture, SparseModel
from scenediff_classic.types import Lens, SparsePoints

INTRINSICS = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
LENS = Lens(320, 240, INTRINSICS, np.zeros(4))
WORLD = np.eye(4)
WORLD[:3, :3] = 1.7 * Rotation.from_rotvec([0.2, -0.5, 0.1]).as_matrix()
WORLD[:3, 3] = [0.4, -1.0, 2.0]
"""The own world of the before model, as seen from the after model's: another scale, too."""
MOVE = np.eye(4)
MOVE[:3, :3] = Rotation.from_rotvec([0, 0.12, 0]).as_matrix()
MOVE[:3, 3] = [0.3, 0.0, -0.2]


def carried(xyz: np.ndarray, motion: np.ndarray) -> np.ndarray:
    return xyz @ motion[:3, :3].T + motion[:3, 3]


def own_model(xyz: np.ndarray, video: str, world: np.ndarray) -> SparseModel:
    """Four cameras on an arc that see all the points, in a world of the model's own."""
    scale = np.cbrt(np.linalg.det(world[:3, :3]))
    pictures = []
    for k, x in enumerate((-0.6, -0.2, 0.2, 0.6)):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec([0, -0.15 * x, 0]).as_matrix()
        pose[:3, 3] = -pose[:3, :3] @ [x, 0.1 if video == "after" else 0.0, 0]
        turned = pose[:3, :3] @ world[:3, :3] / scale
        pose[:3, 3] = (pose[:3, 3] + pose[:3, :3] @ world[:3, 3]) / scale
        pose[:3, :3] = turned
        pictures.append(PosedPicture(f"{video}/{k:05d}.png", LENS, pose))
    here = carried(xyz, np.linalg.inv(world))
    point, picture = (a.ravel() for a in np.indices((len(xyz), 4)))
    seen = [project(here, INTRINSICS, posed.cam_from_world)[0] for posed in pictures]
    keypoints = np.stack(seen, axis=1).reshape(-1, 2)
    points = SparsePoints(
        here, np.zeros((len(xyz), 3), np.uint8), np.stack([point, picture], axis=1)
    )
    return SparseModel(tuple(pictures), points, 0.5, keypoints, point)


def scene(moved: int, room: int = 150) -> tuple[SparseModel, SparseModel, np.ndarray, np.ndarray]:
    """A room four to five metres away, and things two to three metres away that all move."""
    rng = np.random.default_rng(0)
    far = rng.uniform([-1.6, -1.2, 4], [1.6, 1.2, 5], (room, 3))
    near = rng.uniform([-0.6, -0.4, 2], [0.5, 0.4, 3], (moved, 3))
    before = own_model(np.concatenate([far, near]), "before", WORLD)
    after = own_model(np.concatenate([far, carried(near, MOVE)]), "after", np.eye(4))
    looks = rng.normal(size=(room + moved, 32))
    noisy = [looks + rng.normal(0, 0.3, looks.shape) for _ in range(2)]
    first, second = (
        (n / np.linalg.norm(n, axis=1, keepdims=True)).astype(np.float32) for n in noisy
    )
    return before, after, first, second


def test_nothing_moved_is_one_way_only() -> None:
    ways = alignments(*scene(0))
    assert len(ways) == 1
    np.testing.assert_allclose(ways[0].motion, WORLD, atol=1e-6)
    assert ground_share(ways) == 0


@pytest.mark.parametrize("moved", [60, 150, 400])
def test_the_room_is_told_from_what_moved_and_both_are_reported(moved: int) -> None:
    """Also where what moved has most of the points."""
    room, things = alignments(*scene(moved))
    np.testing.assert_allclose(room.motion, WORLD, atol=1e-6)
    np.testing.assert_allclose(things.motion, MOVE @ WORLD, atol=1e-6)
    assert len(room.pairs) >= 148
    assert len(things.pairs) >= 0.98 * moved
    assert room.depth > things.depth
    assert ground_share((room, things)) >= AMBIGUOUS


def test_a_single_moved_thing_is_not_ambiguous() -> None:
    """Its twenty points lie in a few cells of the pictures."""
    before, after, *looks = scene(20)
    for model in (before, after):
        middle = model.points.xyz[150:].mean(axis=0)
        model.points.xyz[150:] += 0.85 * (middle - model.points.xyz[150:])
    room, thing = alignments(before, after, *looks)
    np.testing.assert_allclose(room.motion, WORLD, atol=1e-6)
    assert len(thing.pairs) == 20
    assert ground_share((room, thing)) < AMBIGUOUS


def test_looks_that_mean_nothing_lay_nothing_over_each_other() -> None:
    before, after, first, second = scene(60)
    rng = np.random.default_rng(1)
    assert alignments(before, after, first, second[rng.permutation(len(second))]) == ()
    points = after.points
    two = SparsePoints(points.xyz[:2], points.rgb[:2], points.observations[:8])
    assert alignments(before, replace(after, points=two), first, second[:2]) == ()


def test_joined_models_are_one_in_the_world_of_the_second() -> None:
    before, after, *looks = scene(60)
    room = alignments(before, after, *looks)[0]
    joint = join(before, after, room.motion, room.pairs)
    assert [p.name for p in joint.pictures] == sorted(p.name for p in joint.pictures)
    for k, x in enumerate((-0.6, -0.2, 0.2, 0.6)):
        for number, y in ((k, 0.1), (4 + k, 0.0)):
            centre = camera_centre(joint.pictures[number].cam_from_world)
            np.testing.assert_allclose(centre, [x, y, 0], atol=1e-6)
    assert len(joint.points.xyz) == 2 * 210 - len(room.pairs)
    assert joint.keypoints is not None
    point, picture = joint.points.observations.T
    for number, posed in enumerate(joint.pictures):
        seen = joint.points.xyz[point[picture == number]]
        xy, _ = project(seen, INTRINSICS, posed.cam_from_world)
        np.testing.assert_allclose(xy, joint.keypoints[picture == number], atol=1e-3)


def test_looks_are_the_mean_of_a_points_descriptors() -> None:
    _, after, *_ = scene(0, room=3)
    rng = np.random.default_rng(0)
    found = rng.integers(0, 256, (len(after.pictures), 3, 128), np.uint8)
    looks = looks_of(after, found)
    mean = found.mean(axis=0)
    np.testing.assert_allclose(looks, mean / np.linalg.norm(mean, axis=1)[:, None], rtol=1e-5)
