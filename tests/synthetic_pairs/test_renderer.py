"""Pictures, depth and ids against cases that can be worked out by hand."""

import numpy as np
import pytest

from data_tools.synthetic_pairs.atlas import Atlas, pyramid
from data_tools.synthetic_pairs.lighting import AreaLight, Lighting
from data_tools.synthetic_pairs.meshes import Mesh, box, quad, sphere
from data_tools.synthetic_pairs.models import Material, Model, Part
from data_tools.synthetic_pairs.renderer import Renderer
from data_tools.synthetic_pairs.sensor import Sensor, tone
from data_tools.synthetic_pairs.tracer import Camera, Tracer
from data_tools.synthetic_pairs.trajectory import look_at
from scenediff_classic.cameras import camera_centre, project, unproject
from scenediff_classic.types import Lens, View

WHITE = np.full((8, 8, 3), 255, np.uint8)
LAMP = AreaLight((-0.05, -0.05, 3.0), (0, 0.1, 0), (0.1, 0, 0), (2.0, 2.0, 2.0))
DARK = Lighting((), (0, 0, 0), (0, 0, 0), 0.0)
LIT = Lighting((LAMP,), (0, 0, 0), (0, 0, 0), 0.0)
FLOOR = quad((-5, -5, 0), (10, 0, 0), (0, 10, 0))


def _model(mesh: Mesh, texture: np.ndarray = WHITE, gloss: float = 0.0) -> Model:
    return Model("thing", (Part(mesh, Material(texture, gloss)),))


def _camera(eye: tuple[float, float, float], aim: tuple[float, float, float]) -> Camera:
    intrinsics = np.array([[60.0, 0, 40], [0, 60.0, 30], [0, 0, 1]])
    return Camera(80, 60, intrinsics, look_at(np.array(eye, float), np.array(aim, float)))


def test_look_at_is_upright_and_centres_its_aim() -> None:
    camera = _camera((1.0, -2.0, 1.5), (0.2, 0.3, 0.4))
    np.testing.assert_allclose(camera_centre(camera.cam_from_world), [1, -2, 1.5], atol=1e-12)
    points = np.array([[0.2, 0.3, 0.4], [0.2, 0.3, 0.6]])
    xy, z = project(points, camera.intrinsics, camera.cam_from_world)
    np.testing.assert_allclose(xy[0], [40, 30], atol=1e-9)
    assert xy[1, 0] == pytest.approx(40)
    assert xy[1, 1] < 30  # higher in the world is higher in the picture
    assert z[0] == pytest.approx(np.linalg.norm([0.8, 2.3, 1.1]))


def test_depth_unprojects_onto_the_surface_it_was_cast_at() -> None:
    camera = _camera((0.3, -1.5, 1.2), (0, 0, 0.2))
    scene = [(2, _model(FLOOR)), (7, _model(sphere(0.4, 160)))]
    out = Renderer(scene, DARK).render(camera, seed=0)
    points = unproject(_view(camera, out.depth))
    on_ball, on_floor = out.instances == 7, out.instances == 2
    assert on_ball.sum() > 100
    away = np.linalg.norm(points[on_ball] - [0, 0, 0.4], axis=-1)
    np.testing.assert_allclose(away, 0.4, atol=1e-3)  # a ball of facets
    np.testing.assert_allclose(points[on_floor][:, 2], 0, atol=1e-5)


def test_instances_are_ids_and_nothing_is_no_depth() -> None:
    camera = _camera((0, -2, 0.2), (0, 0, 0.2))
    out = Renderer([(3, _model(box(0.4, 0.4, 0.4)))], DARK).render(camera, seed=0)
    assert set(np.unique(out.instances)) == {0, 3}
    # The front face, 0.4 m wide at 1.8 m: 60 * 0.4 / 1.8 = 13.3 pixels a side.
    assert out.depth[30, 40] == pytest.approx(1.8, abs=1e-5)
    assert np.count_nonzero(out.instances[30] == 3) == pytest.approx(13.3, abs=1)
    assert np.isnan(out.depth[0, 0])
    np.testing.assert_array_equal(np.isfinite(out.depth), out.instances == 3)
    np.testing.assert_array_equal(
        Tracer([(3, _model(box(0.4, 0.4, 0.4)))]).identify(camera), out.instances
    )


def test_light_falls_off_with_the_square_and_the_cosines() -> None:
    camera = _camera((0, -1e-3, 2.0), (0, 0, 0))
    out = Renderer([(0, _model(FLOOR))], LIT).render(camera, seed=0, samples=16)
    # Straight below the lamp, 3 m: 2 / 9. At r aside, with both cosines: 2 * 9 / (9 + r^2)^2.
    assert out.radiance[30, 40, 0] == pytest.approx(2 / 9, rel=0.01)
    aside = (70.5 - 40) / 60 * 2.0
    expected = 2 * 9 / (9 + aside**2) ** 2
    assert out.radiance[30, 70, 0] == pytest.approx(expected, rel=0.03)


def test_a_thing_throws_a_shadow() -> None:
    # The lamp at x = 0, 3 m up, throws the board (0.45 to 0.75, 0.4 m up) on the floor from
    # 0.45 * 3 / 2.6 = 0.52 to 0.75 * 3 / 2.59 = 0.87; the camera sees the middle of it.
    camera = _camera((2.0, 0, 2.5), (0.7, 0, 0))
    board = box(0.3, 0.3, 0.01).moved((0.6, 0, 0.4))
    free = Renderer([(1, _model(FLOOR))], LIT).render(camera, seed=0)
    shaded = Renderer([(1, _model(FLOOR)), (2, _model(board))], LIT).render(camera, seed=0)
    assert shaded.instances[30, 40] == 1
    assert shaded.depth[30, 40] == pytest.approx(free.depth[30, 40])
    assert shaded.radiance[30, 40, 0] < 0.1 * free.radiance[30, 40, 0]


def test_same_seed_same_picture() -> None:
    camera = _camera((0.3, -1.5, 1.2), (0, 0, 0.2))
    scene = [(0, _model(FLOOR)), (7, _model(sphere(0.4), gloss=0.5))]
    first, second = (Renderer(scene, LIT).render(camera, seed=4) for _ in range(2))
    np.testing.assert_array_equal(first.radiance, second.radiance)


def test_edges_are_smooth() -> None:
    camera = _camera((0.0, -2.0, 0.21), (0, 0, 0.2))
    black = np.zeros((8, 8, 3), np.uint8)
    sky = Lighting((), (1, 1, 1), (1, 1, 1), 0.0)
    scene = [(0, _model(quad((-3, 1, -3), (6, 0, 0), (0, 0, 6)))), (1, _model(sphere(0.2), black))]
    grey = Renderer(scene, sky).render(camera, seed=0).radiance[..., 0]
    between = (grey > 0.1) & (grey < 0.8)
    outline = 2 * np.pi * 60 * 0.2 / 2
    assert 0.5 * outline < np.count_nonzero(between) < 3 * outline


def test_atlas_reads_texels_upright_and_averages_from_afar() -> None:
    texture = np.zeros((4, 4, 3), np.uint8)
    texture[0, 0] = 255  # top left
    atlas = Atlas([pyramid(WHITE), pyramid(texture)])
    which = np.array([1, 1, 1, 0])
    uv = np.array([[0.125, 0.875], [0.125, 0.125], [0.5, 0.5], [0.3, 0.3]], np.float32)
    near = atlas.look_up(which, uv, np.zeros(4, np.float32))
    np.testing.assert_allclose(near[:, 0], [1, 0, 0, 1], atol=1e-6)
    far = atlas.look_up(which, uv, np.full(4, 1.0, np.float32))
    np.testing.assert_allclose(far[:3, 0], 1 / 16, atol=2e-3)


def test_textures_must_be_powers_of_two() -> None:
    with pytest.raises(ValueError, match="power of two"):
        pyramid(np.zeros((6, 6, 3), np.uint8))


def test_exposure_grows_and_noise_has_the_asked_strength() -> None:
    light = np.full((80, 80, 3), 0.18, np.float32)
    quiet = Sensor(1.0, (1, 1, 1), 0.0, 0.0, 0.0)
    np.testing.assert_array_equal(quiet.expose(light, 1), 118)  # mid-grey in sRGB
    brighter = Sensor(1.5, (1.1, 1, 0.9), 0.0, 0.0, 0.0).expose(light, 1)[0, 0]
    assert brighter[0] > brighter[1] > brighter[2] > 118
    noisy = Sensor(1.0, (1, 1, 1), 0.01, 0.0, 0.0).expose(light, 1).astype(float)
    # d(sRGB)/d(light) at mid-grey is 1.055 / 2.4 * 0.18^(1/2.4 - 1) = 1.195.
    assert noisy.std() == pytest.approx(0.01 * np.sqrt(1.25) * 1.195 * 255, rel=0.05)


def test_the_tone_curve_is_monotone_and_keeps_to_its_range() -> None:
    values = tone(np.linspace(-0.1, 20, 2000).astype(np.float32))
    assert values.min() >= 0
    assert values.max() <= 1
    assert np.diff(values).min() >= -1e-6


def _view(camera: Camera, depth: np.ndarray) -> View:
    shape = depth.shape
    lens = Lens(camera.width, camera.height, camera.intrinsics, np.zeros(4))
    return View(
        "before",
        0,
        "0",
        np.zeros((*shape, 3), np.uint8),
        camera.intrinsics,
        camera.cam_from_world,
        depth,
        np.ones(shape, np.float32),
        np.ones(shape, bool),
        np.zeros(shape, bool),
        lens,
    )
