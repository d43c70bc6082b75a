"""Projective geometry: inverses undo each other, and samples are where they should be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from scenediff_classic import cameras
from scenediff_classic.types import Lens
from tests.plane_scene import BOOK, VASE, render


def pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = np.eye(4)
    out[:3, :3] = Rotation.random(random_state=rng.integers(2**31)).as_matrix()
    out[:3, 3] = rng.normal(size=3)
    return out


@given(st.integers(0, 10_000))
def test_pose_inverse_and_centre(seed):
    cam_from_world = pose(seed)
    inverse = cameras.world_from_cam(cam_from_world)
    np.testing.assert_allclose(inverse @ cam_from_world, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(cameras.camera_centre(cam_from_world), inverse[:3, 3], atol=1e-12)


def test_project_undoes_unproject():
    view = render([VASE, BOOK], "before", 0, (0.1, -0.2, 0.05))
    xy, z = cameras.project(
        cameras.unproject(view).astype(float), view.intrinsics, view.cam_from_world
    )
    np.testing.assert_allclose(xy, cameras.pixel_centres(*view.shape), atol=1e-3)
    np.testing.assert_allclose(z, view.depth, rtol=1e-5)


def test_points_behind_the_camera_have_no_pixel():
    xy, z = cameras.project(np.array([[0.0, 0, -1], [0, 0, 0], [0, 0, 2]]), np.eye(3), np.eye(4))
    assert np.isnan(xy[:2]).all()
    assert np.isfinite(xy[2]).all()
    assert z.tolist() == [-1, 0, 2]
    assert cameras.inside(xy, 1, 1).tolist() == [False, False, True]


@pytest.mark.parametrize("nearest", [False, True])
def test_sampling_at_pixel_centres_is_exact(nearest):
    image = np.random.default_rng(0).random((5, 7, 2)).astype(np.float32)
    out = cameras.sample(image, cameras.pixel_centres(5, 7), nearest=nearest)
    np.testing.assert_array_equal(out, image)


def test_sampling_between_centres_and_outside():
    image = np.array([[0.0, 1.0], [2.0, 3.0]], np.float32)
    xy = np.array([[[1.0, 1.0], [0.1, 0.1], [2.0, 1.0], [np.nan, 1.0]]])
    out = cameras.sample(image, xy)[0]
    assert out[0] == pytest.approx(1.5)
    assert out[1] == 0  # the outer half pixel is held
    assert np.isnan(out[2:]).all()


def test_nearest_sampling_takes_the_pixel_that_holds_the_position():
    image = np.arange(4, dtype=np.float32)[None]
    xy = np.array([[[0.99, 0.5], [1.0, 0.5], [1.99, 0.5], [3.99, 0.5]]])
    assert cameras.sample(image, xy, nearest=True)[0].tolist() == [0, 1, 1, 3]


def lens(*distortion: float) -> Lens:
    intrinsics = np.array([[400.0, 0, 321], [0, 402, 238], [0, 0, 1]])
    return Lens(640, 480, intrinsics, np.array(distortion, float))


WORKING = np.array([[200.0, 0, 160], [0, 201, 120], [0, 0, 1]])


@given(
    st.floats(-0.15, 0.15),
    st.floats(-0.02, 0.02),
    st.floats(-0.003, 0.003),
    st.floats(-0.003, 0.003),
)
def test_lens_distortion_is_inverted(k1, k2, p1, p2):
    xy = cameras.pixel_centres(480, 640)[::37, ::41]
    there = cameras.view_from_source(xy, lens(k1, k2, p1, p2), WORKING)
    back = cameras.source_from_view(there, lens(k1, k2, p1, p2), WORKING)
    solved = np.isfinite(there).all(axis=-1)
    np.testing.assert_allclose(back[solved], xy[solved], atol=0.01)
    # the polynomial k1, k2 grows with the radius only up to a turning point
    rays = (xy - lens(0, 0, 0, 0).intrinsics[:2, 2]) / np.diag(lens(0, 0, 0, 0).intrinsics)[:2]
    assert solved[np.linalg.norm(rays, axis=-1) < 0.7].all()


def test_mask_goes_back_to_the_input_through_the_distortion():
    glass = lens(-0.1, 0.01, 0, 0)
    mask = np.zeros((240, 320), bool)
    mask[60:120, 40:150] = True
    source = cameras.mask_to_source(mask, glass, WORKING)
    assert source.shape == (480, 640)
    corners = np.array([[[40.0, 60], [150, 60], [40, 120], [150, 120]]])
    xy = cameras.source_from_view(corners, glass, WORKING)[0]
    rows, columns = np.nonzero(source)
    assert columns.min() == pytest.approx(xy[:, 0].min(), abs=3)
    assert columns.max() == pytest.approx(xy[:, 0].max(), abs=3)
    assert rows.min() == pytest.approx(xy[:, 1].min(), abs=3)


def test_undistorting_with_the_same_camera_changes_nothing():
    image = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    intrinsics = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])
    plain = Lens(64, 48, intrinsics, np.zeros(4))
    out, outside = cameras.undistort(image, plain, intrinsics, 48, 64)
    np.testing.assert_array_equal(out, image)
    assert not outside.any()
