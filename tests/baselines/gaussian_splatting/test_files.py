from pathlib import Path

import av
import numpy as np
import pytest
import torch

from baselines.gaussian_splatting.ply import property_names, read_gaussians, write_gaussians
from baselines.gaussian_splatting.trajectory import smooth_path, write_trajectory
from scenediff_classic.errors import InputError, OutputError
from tests.baselines.gaussian_splatting.scenes import CAMERA, cloud
from tests.geometry.textured_room import look_at


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_what_is_written_is_read_back(tmp_path: Path, degree: int) -> None:
    gaussians = cloud(7, torch.float32, degree=degree)
    write_gaussians(tmp_path / "scene.ply", gaussians)
    read = read_gaussians(tmp_path / "scene.ply")
    for a, b in zip(vars(read).values(), vars(gaussians).values(), strict=True):
        assert torch.equal(a, b)


def test_the_layout_is_the_standard_one(tmp_path: Path) -> None:
    gaussians = cloud(2, torch.float32, degree=1)
    write_gaussians(tmp_path / "scene.ply", gaussians)
    header, body = (tmp_path / "scene.ply").read_bytes().split(b"end_header\n")
    assert header.decode().splitlines() == [
        "ply", "format binary_little_endian 1.0", "element vertex 2",
        *(f"property float {n}" for n in (
            "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2",
            "f_rest_0", "f_rest_1", "f_rest_2", "f_rest_3", "f_rest_4", "f_rest_5", "f_rest_6",
            "f_rest_7", "f_rest_8", "opacity", "scale_0", "scale_1", "scale_2",
            "rot_0", "rot_1", "rot_2", "rot_3",
        )),
    ]  # fmt: skip
    row = np.frombuffer(body, "<f4").reshape(2, -1)[1]
    red = gaussians.sh[1, 1:, 0].numpy()  # channel by channel
    np.testing.assert_array_equal(row[9:12], red)
    assert row[18] == float(gaussians.opacity_logits[1])


def broken(tmp_path: Path, old: bytes, new: bytes) -> Path:
    path = tmp_path / "broken.ply"
    write_gaussians(path, cloud(3, torch.float32, degree=0))
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"ply\n", b"plx\n", "not a PLY"),
        (b"end_header", b"endheader", "not a PLY"),
        (b"binary_little_endian", b"ascii", "binary little-endian"),
        (b"element vertex 3", b"element vertex 4", "cut off"),
        (b"element vertex 3", b"element vertex x", "no number"),
        (b"element vertex 3", b"element face 3", "first element"),
        (b"property float opacity", b"property float haze", "'opacity' is missing"),
        (b"property float nx", b"property float f_rest_0", "1 properties f_rest"),
        (b"property float nx", b"property half nx", "no splat has"),
        (b"property float nx", b"property float x", "twice"),
    ],
)
def test_malformed_files_are_refused_in_a_sentence(
    tmp_path: Path, old: bytes, new: bytes, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        read_gaussians(broken(tmp_path, old, new))


def test_numbers_that_are_none_are_refused(tmp_path: Path) -> None:
    gaussians = cloud(3, torch.float32)
    gaussians.means[1, 1] = torch.nan
    write_gaussians(tmp_path / "scene.ply", gaussians)
    with pytest.raises(InputError, match="not finite"):
        read_gaussians(tmp_path / "scene.ply")
    with pytest.raises(InputError, match="cannot be read"):
        read_gaussians(tmp_path / "none.ply")


def test_further_elements_and_other_orders_are_read(tmp_path: Path) -> None:
    names = property_names(0)[::-1]
    rows = np.zeros(2, [(n, "<f8") for n in names])
    rows["x"], rows["rot_0"] = [1, 2], 1
    header = ["ply", "format binary_little_endian 1.0", "comment by hand", "element vertex 2"]
    header += [f"property double {n}" for n in names]
    header += ["element camera 1", "property uchar id", "end_header", ""]
    path = tmp_path / "other.ply"
    path.write_bytes("\n".join(header).encode() + rows.tobytes() + b"\x07")
    assert read_gaussians(path).means[:, 0].tolist() == [1, 2]


def test_a_trajectory_becomes_a_video(tmp_path: Path) -> None:
    target = np.array([0, 0, 4.0])
    cameras = [
        type(CAMERA)(CAMERA.intrinsics, look_at(np.array([x, 0.0, 0]), target), 37, 50)
        for x in (-0.5, 0.0, 0.5)
    ]
    path = smooth_path(cameras, between=4)
    assert len(path) == 9
    np.testing.assert_allclose(path[4].cam_from_world, cameras[1].cam_from_world, atol=1e-12)
    between = path[2].cam_from_world
    np.testing.assert_allclose(-between[:3, :3].T @ between[:3, 3], [-0.25, 0, 0], atol=1e-12)
    np.testing.assert_allclose(between[:3, :3] @ between[:3, :3].T, np.eye(3), atol=1e-12)
    video = tmp_path / "new" / "flight.mp4"
    write_trajectory(video, cloud(50, torch.float32), path, fps=10)
    with av.open(str(video)) as container:
        frames = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
    assert len(frames) == 9
    assert frames[0].shape == (36, 50, 3)
    assert frames[0].max() > 40
    assert [p.name for p in video.parent.iterdir()] == ["flight.mp4"]


def test_a_trajectory_needs_a_camera_and_a_place(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        smooth_path([])
    with pytest.raises(InputError):
        write_trajectory(tmp_path / "none.mp4", cloud(4, torch.float32), [])
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError):
        write_trajectory(tmp_path / "file" / "x.mp4", cloud(4, torch.float32), [CAMERA])
