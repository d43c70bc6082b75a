"""Shapes stand on the ground, face outwards and carry usable texture coordinates."""

import numpy as np
import pytest

from data_tools.synthetic_pairs import meshes
from data_tools.synthetic_pairs.meshes import Mesh
from data_tools.synthetic_pairs.models import Builder, Paint
from data_tools.synthetic_pairs.styles import TEST, VAL, Style

SOLIDS = {
    "box": meshes.box(0.2, 0.3, 0.4),
    "sphere": meshes.sphere(0.2),
    "cylinder": meshes.cylinder(0.1, 0.3),
    "stretched sphere": meshes.sphere(0.2).stretched(1.0, 2.0, 0.5),
    "vase": meshes.lathe([(0.1, 0.0), (0.2, 0.2), (0.1, 0.4)], smooth=True),
}


@pytest.mark.parametrize("name", SOLIDS)
def test_normals_are_unit_and_point_outwards(name: str) -> None:
    mesh = SOLIDS[name]
    middle = 0.5 * (mesh.points.reshape(-1, 3).min(0) + mesh.points.reshape(-1, 3).max(0))
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=-1), 1, atol=1e-5)
    assert ((mesh.points - middle) * mesh.normals).sum(-1).min() > -1e-6


def test_sphere_has_the_right_size_and_touches_the_ground() -> None:
    mesh = meshes.sphere(0.5)
    centre = np.array([0, 0, 0.5])
    np.testing.assert_allclose(np.linalg.norm(mesh.points - centre, axis=-1), 0.5, atol=1e-6)
    assert mesh.points[..., 2].min() == pytest.approx(0, abs=1e-6)


def test_box_has_the_area_of_its_faces() -> None:
    assert _area(meshes.box(1, 2, 3)) == pytest.approx(2 * (1 * 2 + 2 * 3 + 1 * 3))


def test_tube_keeps_its_distance_from_the_path() -> None:
    path = meshes.arc(0.3, 0.2, 0, np.pi, 40)
    tube = meshes.tube(path, 0.05)
    away = np.linalg.norm(tube.points.reshape(-1, 1, 3) - path, axis=-1).min(axis=1)
    np.testing.assert_allclose(away, 0.05, atol=1e-3)


def test_moving_turns_before_it_shifts() -> None:
    mesh = meshes.quad((1, 0, 0), (1, 0, 0), (0, 1, 0)).moved((0, 0, 5), yaw=np.pi / 2)
    np.testing.assert_allclose(mesh.points[0, 0], [0, 1, 5], atol=1e-6)
    tilted = meshes.quad((0, 0, 0), (1, 0, 0), (0, 0, 1)).moved(tilt=np.pi / 2)
    np.testing.assert_allclose(tilted.normals[0, 0], [0, 0, -1], atol=1e-6)


@pytest.mark.parametrize("style", [VAL, TEST], ids=["val", "test"])
def test_every_object_family_stands_upright_on_the_ground(style: Style) -> None:
    for family in (*style.table_objects, *style.floor_objects):
        for seed in range(3):
            model = family(np.random.default_rng(seed), _paint(style, seed))
            points = np.concatenate([p.mesh.points.reshape(-1, 3) for p in model.parts])
            assert points[:, 2].min() == pytest.approx(0, abs=0.012), model.label
            assert points[:, 2].min() > -0.008, model.label
            assert 0.04 < model.radius < 0.4, model.label
            assert 0.05 < model.height < 1.0, model.label
            middle = points[:, :2].mean(axis=0)
            assert np.linalg.norm(middle) < 0.6 * model.radius, model.label


def test_a_family_is_decided_by_its_generators() -> None:
    def build(family: Builder, shape: int, paint: int) -> list[np.ndarray]:
        model = family(np.random.default_rng(shape), _paint(VAL, paint))
        return [
            np.concatenate([p.mesh.points.ravel() for p in model.parts]),
            np.concatenate([p.material.texture.ravel() for p in model.parts]),
        ]

    bottle = VAL.table_objects[2]
    shape, look = build(bottle, 1, 1)
    same_shape, same_look = build(bottle, 1, 1)
    np.testing.assert_array_equal(shape, same_shape)
    np.testing.assert_array_equal(look, same_look)
    near_shape, near_look = build(bottle, 1, 2)
    np.testing.assert_array_equal(shape, near_shape)
    assert not np.array_equal(look, near_look)


def _paint(style: Style, seed: int) -> Paint:
    return Paint(np.random.default_rng(seed), style.prints, style.covers, style.woods, size=32)


def _area(mesh: Mesh) -> float:
    a, b = mesh.points[:, 1] - mesh.points[:, 0], mesh.points[:, 2] - mesh.points[:, 0]
    return float(np.linalg.norm(np.cross(a, b), axis=1).sum() / 2)
