"""The last adjustment: what a free optical centre must show, and what a robust loss is for."""

from pathlib import Path

import numpy as np
import pytest

from scenediff_classic.geometry.registration.colmap import pycolmap
from scenediff_classic.geometry.registration.colmap.models import adjust, read_model
from scenediff_classic.geometry.registration.refinement import Evidence, refine
from scenediff_classic.geometry.registration.sparse_model import residuals


def made(folder: Path, centre: tuple[float, float] = (512, 384), wrong: float = 0.0) -> Path:
    """A rendered reconstruction with noisy keypoints, its optical centre set to the middle."""
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 12
    options.num_points3D = 150
    options.camera_model_id = pycolmap.CameraModelId.SIMPLE_RADIAL
    options.camera_params = [900, *centre, 0.0]
    model = pycolmap.synthesize_dataset(options)
    noise = pycolmap.SyntheticNoiseOptions()
    noise.point2D_stddev = 0.5
    pycolmap.synthesize_noise(noise, model)
    rng = np.random.default_rng(0)
    for image in model.images.values():
        for point in image.points2D:
            if point.has_point3D() and rng.uniform() < wrong:
                point.xy = point.xy + rng.uniform(5, 20, 2)
    for camera in model.cameras.values():
        camera.principal_point_x, camera.principal_point_y = 512, 384
    folder.mkdir(parents=True)
    model.write(folder)
    return folder


def centre_of(folder: Path) -> np.ndarray:
    return read_model(folder).pictures[0].lens.intrinsics[:2, 2]


def test_a_centre_in_the_middle_stays_there(tmp_path: Path) -> None:
    folder, line = refine(made(tmp_path / "model"), tmp_path / "refined", lens=True)
    np.testing.assert_array_equal(centre_of(folder), [512, 384])
    assert "optical centre" not in line


def test_a_centre_beside_the_middle_is_found(tmp_path: Path) -> None:
    folder, line = refine(made(tmp_path / "model", (472, 404)), tmp_path / "refined", lens=True)
    np.testing.assert_allclose(centre_of(folder), [472, 404], atol=3)
    assert "optical centre 4" in line


def test_two_pictures_keep_their_lens(tmp_path: Path) -> None:
    model = made(tmp_path / "model", (480, 400))
    folder, _ = refine(model, tmp_path / "refined", lens=False)
    for one, other in zip(read_model(model).pictures, read_model(folder).pictures, strict=True):
        np.testing.assert_array_equal(one.lens.intrinsics, other.lens.intrinsics)


def test_wrong_matches_hardly_bend_the_cameras(tmp_path: Path) -> None:
    model = made(tmp_path / "model", wrong=0.05)
    robust = adjust(model, tmp_path / "robust", 1.0, lens=True)
    squares = adjust(model, tmp_path / "squares", 1e4, lens=True)
    focal = [read_model(f).pictures[0].lens.intrinsics[0, 0] for f in (robust, squares)]
    assert abs(focal[0] - 900) < abs(focal[1] - 900)
    assert abs(focal[0] - 900) < 5
    errors = [np.median(np.abs(residuals(read_model(f)))) for f in (robust, squares)]
    assert errors[0] < errors[1]


@pytest.mark.parametrize(
    ("gain", "residuals", "shift", "convincing"),
    [
        (2800, 94714, 0.029, True),  # templeRing
        (21, 28312, 0.004, False),  # a rendered pair
        (17, 7088, 0.006, False),  # 5 + 5 photos of it
        (330, 4444, 0.027, True),  # 5 + 5 photos, 4 percent cut off
        (300, 94714, 0.029, False),  # significant by its sum alone
        (50, 500, 0.029, False),  # too few residuals
        (1018, 83476, 0.0125, False),  # RedKitchen
        (2800, 94714, 0.3, False),
    ],
)
def test_evidence(gain: float, residuals: int, shift: float, convincing: bool) -> None:
    assert Evidence(gain, residuals, shift).convincing == convincing
