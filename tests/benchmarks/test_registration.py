"""Comparing cameras with known ones, and reading the known ones."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_tools.benchmarks.registration import compare_cameras, read_true_cameras
from scenediff_classic.cameras import world_from_cam
from scenediff_classic.errors import InputError
from scenediff_classic.types import Capture, Frame, Video


def cameras(count: int = 8, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, random_state=seed).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(count, 3))
    return poses


def in_another_world(poses: np.ndarray, scale: float) -> np.ndarray:
    """The same cameras after the world was turned, moved and scaled."""
    turn, shift = Rotation.from_rotvec([0.3, -1.2, 0.7]).as_matrix(), np.array([4.0, -2.0, 9.0])
    out = np.tile(np.eye(4), (len(poses), 1, 1))
    for k, pose in enumerate(poses):
        centre = -pose[:3, :3].T @ pose[:3, 3]
        out[k, :3, :3] = pose[:3, :3] @ turn.T
        out[k, :3, 3] = -out[k, :3, :3] @ (scale * turn @ centre + shift)
    return out


def capture(video: Video, names: list[str], times: list[float] | None = None) -> Capture:
    image = np.zeros((4, 6, 3), np.uint8)
    frames = tuple(
        Frame(video, k, name, None if times is None else times[k], image, 6, 4)
        for k, name in enumerate(names)
    )
    return Capture(video, "folder", frames)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 250.0])
def test_another_world_is_no_error(scale: float) -> None:
    true = cameras()
    errors = compare_cameras(in_another_world(true, scale), true)
    assert errors.rotation_deg.max() < 1e-4  # arccos near 1
    assert errors.centre.max() < 1e-9 * errors.extent


def test_errors_have_their_size() -> None:
    true = cameras(40)
    found = true.copy()
    turn = Rotation.from_rotvec([0, np.radians(5), 0]).as_matrix()
    found[3, :3] = turn @ found[3, :3]  # turned on the spot: its centre stays
    errors = compare_cameras(found, true)
    assert errors.rotation_deg[3] == pytest.approx(5, abs=1e-3)
    assert np.delete(errors.rotation_deg, 3).max() < 1e-3
    assert errors.centre.max() < 1e-9


def test_a_mirrored_world_is_no_similarity() -> None:
    true = cameras(12)
    mirrored = true.copy()
    for pose, source in zip(mirrored, true, strict=True):
        centre = -source[:3, :3].T @ source[:3, 3] * [1, 1, -1]
        pose[:3, 3] = -pose[:3, :3] @ centre
    assert compare_cameras(mirrored, true).centre.max() > 0.1


def test_too_few_or_collinear_cameras_are_refused() -> None:
    with pytest.raises(InputError, match="Fewer than three"):
        compare_cameras(cameras(2), cameras(2))
    line = np.tile(np.eye(4), (5, 1, 1))
    line[:, 0, 3] = np.arange(5)
    with pytest.raises(InputError, match="on one line"):
        compare_cameras(line, line)


def test_reads_the_truth_of_a_rendered_pair(tmp_path: Path) -> None:
    path, poses = tmp_path / "truth_geometry.npz", cameras(3)
    np.savez(path, cam_from_world=poses)
    before, after = capture("before", ["0000.png"]), capture("after", ["0000.png", "0001.png"])
    found = read_true_cameras(path, before, after)
    assert list(found) == [("before", 0), ("after", 0), ("after", 1)]
    np.testing.assert_array_equal(np.stack(list(found.values())), poses)
    with pytest.raises(InputError, match="one camera for each"):
        read_true_cameras(path, before, before)


def test_reads_a_middlebury_list(tmp_path: Path) -> None:
    path, poses = tmp_path / "x_par.txt", cameras(2)
    lines = ["2"]
    for name, pose in zip(("a.png", "b.png"), poses, strict=True):
        numbers = [*np.eye(3).ravel(), *pose[:3, :3].ravel(), *pose[:3, 3]]
        lines.append(" ".join([name, *map(repr, map(float, numbers))]))
    path.write_text("\n".join(lines))
    found = read_true_cameras(path, capture("before", ["b.png"]), capture("after", ["c.png"]))
    assert list(found) == [("before", 0)]  # c.png is not in the list
    np.testing.assert_allclose(found["before", 0], poses[1])


def test_reads_the_poses_of_a_video_by_time(tmp_path: Path) -> None:
    path, poses = tmp_path / "poses.txt", cameras(40)
    rows = [
        f"{k:06d} " + " ".join(map(str, world_from_cam(p).ravel())) for k, p in enumerate(poses)
    ]
    path.write_text("# frame, then 16 numbers\n" + "\n".join(rows))
    film = capture("before", ["v#0", "v#1"], [0.0, 0.5])
    found = read_true_cameras(path, film, capture("after", ["v#0"], [1.0]))
    for key, number in ((("before", 0), 0), (("before", 1), 15), (("after", 0), 30)):
        np.testing.assert_allclose(found[key], poses[number], atol=1e-12)


def test_poses_of_a_video_that_stretch_a_little_become_rigid(tmp_path: Path) -> None:
    path, (pose,) = tmp_path / "poses.txt", cameras(1)
    film = capture("before", ["v#0"], [0.0]), capture("after", ["v#0"], [1.0])

    def read(stretch: float) -> np.ndarray:
        row = world_from_cam(pose)
        row[:3, :3] *= 1 + stretch
        path.write_text("000000 " + " ".join(map(str, row.ravel())))
        return read_true_cameras(path, *film)["before", 0]

    np.testing.assert_allclose(read(2e-4), pose, atol=1e-9)
    with pytest.raises(InputError, match="known layout"):
        read(0.5)


@pytest.mark.parametrize("content", ["nothing like it at all", "a.png 1 2 3", ""])
def test_other_files_are_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(content)
    one = capture("before", ["a.png"]), capture("after", ["b.png"])
    if content:
        with pytest.raises(InputError, match="known layout"):
            read_true_cameras(path, *one)
    else:
        assert read_true_cameras(path, *one) == {}
