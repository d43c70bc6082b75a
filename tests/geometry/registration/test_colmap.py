"""The one door to COLMAP: import order, models in and out."""

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import scenediff_classic
from scenediff_classic.errors import InputError
from scenediff_classic.geometry.registration.colmap import pycolmap
from scenediff_classic.geometry.registration.colmap.database import check_learned
from scenediff_classic.geometry.registration.colmap.models import read_model, write_model
from scenediff_classic.geometry.registration.sparse_model import PosedPicture, SparseModel
from scenediff_classic.types import Lens, SparsePoints
from tests.geometry.cards import INTRINSICS, sweep

SOURCES = Path(scenediff_classic.__file__).parent


def test_zlib_survives_our_import_of_pycolmap() -> None:
    """Importing pycolmap 4.2.1 first makes the process abort at the next zlib flush."""
    program = (
        "import scenediff_classic.geometry.registration.colmap.models, zlib;"
        "z = zlib.compressobj(); data = z.compress(b'x' * 99999) + z.flush();"
        "print(len(zlib.decompress(data)))"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (run.returncode, run.stdout.strip()) == (0, "99999"), run.stderr


@pytest.mark.parametrize("name", ["SIGTERM", "SIGSEGV"])
def test_a_signal_ends_the_process_without_pages_of_trace(name: str) -> None:
    program = (
        "import scenediff_classic.geometry.registration.colmap, os, signal, time;"
        f"os.kill(os.getpid(), signal.{name}); time.sleep(9)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (-getattr(signal, name), "")


def test_a_handler_of_the_users_own_stays() -> None:
    program = (
        "import os, signal, time; signal.signal(signal.SIGTERM, lambda *_: print('mine'));"
        "import scenediff_classic.geometry.registration.colmap;"
        "os.kill(os.getpid(), signal.SIGTERM); time.sleep(0.1)"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (run.returncode, run.stdout.strip(), run.stderr) == (0, "mine", "")


def test_only_one_package_imports_pycolmap() -> None:
    packages = (SOURCES, SOURCES.parent / "baselines", SOURCES.parent / "data_tools")
    importing = {
        path.parent
        for package in packages
        for path in package.rglob("*.py")
        if any(
            line.strip().startswith(("import pycolmap", "from pycolmap"))
            for line in path.read_text(encoding="utf-8").splitlines()
        )
    }
    assert importing == {SOURCES / "geometry" / "registration" / "colmap"}


@pytest.mark.parametrize("write", ["write_binary", "write_text"])
def test_synthetic_dataset_is_read_as_it_was_made(write: str, tmp_path: Path) -> None:
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_points3D = 50
    truth = pycolmap.synthesize_dataset(options)
    getattr(truth, write)(tmp_path)
    model = read_model(tmp_path)
    assert len(model.pictures) == 10
    for picture in model.pictures:
        image = truth.find_image_with_name(picture.name)
        np.testing.assert_allclose(picture.cam_from_world[:3], image.cam_from_world().matrix())
        np.testing.assert_array_equal(
            picture.lens.intrinsics, [[1280, 0, 512], [0, 1280, 384], [0, 0, 1]]
        )
        np.testing.assert_array_equal(picture.lens.distortion, [0.05, 0, 0, 0])
    assert len(model.points.xyz) == 50
    # the 10 extra keypoints without a point are no observations
    assert len(model.points.observations) == truth.compute_num_observations()


def example_model() -> SparseModel:
    lens = Lens(320, 240, INTRINSICS, np.array([0.05, -0.01, 0.001, -0.002]))
    pictures = tuple(PosedPicture(f"before/{i}.png", lens, pose) for i, pose in enumerate(sweep(3)))
    xyz = np.array([[0.0, 0.1, 3.0], [0.3, -0.2, 3.5], [-0.4, 0.0, 2.8]])
    rgb = np.array([[1, 2, 3], [40, 50, 60], [255, 0, 128]], np.uint8)
    observations = np.array([[0, 0], [0, 1], [0, 2], [1, 0], [1, 2], [2, 1], [2, 2]])
    return SparseModel(pictures, SparsePoints(xyz, rgb, observations), float("nan"))


def test_model_survives_writing_and_reading(tmp_path: Path) -> None:
    model = example_model()
    write_model(model, tmp_path / "sparse")
    again = read_model(tmp_path / "sparse")
    for one, other in zip(model.pictures, again.pictures, strict=True):
        assert one.name == other.name
        np.testing.assert_allclose(other.cam_from_world, one.cam_from_world, atol=1e-12)
        np.testing.assert_allclose(other.lens.intrinsics, one.lens.intrinsics)
        np.testing.assert_allclose(other.lens.distortion, one.lens.distortion)
    np.testing.assert_allclose(again.points.xyz, model.points.xyz)
    np.testing.assert_array_equal(again.points.rgb, model.points.rgb)
    np.testing.assert_array_equal(again.points.observations, model.points.observations)
    # the written keypoints are the distorted projections: COLMAP measures no error
    reconstruction = pycolmap.Reconstruction(tmp_path / "sparse")
    reconstruction.update_point_3d_errors()
    assert reconstruction.compute_mean_reprojection_error() < 1e-3


def test_a_model_without_points_can_be_written(tmp_path: Path) -> None:
    model = SparseModel(example_model().pictures, SparsePoints.none(), float("nan"))
    write_model(model, tmp_path)
    again = read_model(tmp_path)
    assert len(again.pictures) == 3
    assert np.isnan(again.error)


def test_unsupported_lens_is_refused(tmp_path: Path) -> None:
    options = pycolmap.SyntheticDatasetOptions()
    options.camera_model_id = pycolmap.CameraModelId.OPENCV_FISHEYE
    options.camera_params = [1280, 1280, 512, 384, 0, 0, 0, 0]
    pycolmap.synthesize_dataset(options).write_binary(tmp_path)
    with pytest.raises(InputError, match="OPENCV_FISHEYE"):
        read_model(tmp_path)


def test_a_folder_without_a_model_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="COLMAP model"):
        read_model(tmp_path)
    (tmp_path / "cameras.bin").write_bytes(b"nonsense")
    (tmp_path / "images.bin").write_bytes(b"nonsense")
    (tmp_path / "points3D.bin").write_bytes(b"nonsense")
    with pytest.raises(InputError, match="COLMAP model"):
        read_model(tmp_path)


def test_learned_features_need_their_weights(tmp_path: Path) -> None:
    (tmp_path / "aliked-n16rot.onnx").touch()
    with pytest.raises(InputError, match=r"aliked-lightglue\.onnx is missing"):
        check_learned(tmp_path)
    with pytest.raises(InputError, match="is missing"):
        check_learned(Path("https://example.org/weights"))


def test_learned_features_need_a_build_with_onnx(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("aliked-n16rot.onnx", "aliked-lightglue.onnx"):
        (tmp_path / name).touch()
    monkeypatch.setattr(pycolmap, "FeatureExtractionOptions", object)
    with pytest.raises(InputError, match="without ONNX"):
        check_learned(tmp_path)
