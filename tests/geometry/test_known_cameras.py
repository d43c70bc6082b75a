"""Known geometry: the same value from an .npz, a COLMAP project or a depth camera."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from scenediff_classic.cameras import scale_intrinsics, world_from_cam
from scenediff_classic.errors import InputError
from scenediff_classic.geometry.known_cameras import (
    ColmapGeometry,
    KnownGeometry,
    NpzGeometry,
    read_depth,
)
from scenediff_classic.geometry.known_rgbd import RgbdGeometry
from scenediff_classic.geometry.registration.colmap.models import write_model
from scenediff_classic.geometry.registration.sparse_model import PosedPicture, SparseModel
from scenediff_classic.types import Capture, Frame, Lens, SparsePoints, Video
from tests.geometry.cards import INTRINSICS, look

WIDTH, HEIGHT = 320, 240
POSES = [look((0.1 * i, 0.0, -0.05 * i), 0.1 * i) for i in range(4)]


def wall_depth(scale: float = 1.0) -> np.ndarray:
    """A depth ramp with one unknown pixel block, at a fraction of the picture's size."""
    height, width = round(HEIGHT * scale), round(WIDTH * scale)
    y, x = (np.mgrid[:height, :width] + 0.5) / scale
    depth = (2 + 0.01 * x + 0.005 * y).astype(np.float32)
    depth[: height // 8, : width // 8] = np.nan
    return depth


def captures(count: int = 2) -> tuple[Capture, Capture]:
    rng = np.random.default_rng(0)

    def of(video: Video) -> Capture:
        frames = tuple(
            Frame(
                video, i, f"{video}{i}.color.png", None,
                rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8), WIDTH, HEIGHT,
            )
            for i in range(count)
        )  # fmt: skip
        return Capture(video, video, frames)

    return of("before"), of("after")


def arrays(scale: float = 1.0, count: int = 4) -> dict[str, np.ndarray]:
    return {
        "intrinsics": np.stack([scale_intrinsics(INTRINSICS, scale, scale)] * count),
        "cam_from_world": np.stack(POSES[:count]),
        "depth": np.stack([wall_depth(scale)] * count),
    }


def npz(folder: Path, **content: np.ndarray) -> Path:
    path = folder / "known.npz"
    np.savez(path, **content)
    return path


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_npz_at_any_depth_resolution(scale: float, tmp_path: Path) -> None:
    path = npz(tmp_path, **arrays(scale))
    geometry = KnownGeometry(path, long_side=160)(*captures(), tmp_path)
    assert [view.key for view in geometry.views] == [
        ("before", 0), ("before", 1), ("after", 0), ("after", 1),
    ]  # fmt: skip
    for view, pose in zip(geometry.views, POSES, strict=True):
        np.testing.assert_allclose(view.cam_from_world, pose, atol=1e-12)
        np.testing.assert_allclose(view.intrinsics, scale_intrinsics(INTRINSICS, 0.5, 0.5))
        np.testing.assert_allclose(view.lens.intrinsics, INTRINSICS)
        assert view.shape == (120, 160)
        np.testing.assert_allclose(view.depth, wall_depth(0.5), atol=0.00751)  # half a pixel
        np.testing.assert_array_equal(view.measured, np.isfinite(view.depth))
        np.testing.assert_array_equal(view.confidence, view.measured.astype(np.float32))
        assert not view.ignore.any()


def test_npz_rows_in_any_order_with_video_and_index(tmp_path: Path) -> None:
    order = [2, 1, 3]  # the first frame of before is missing
    content = {key: value[order] for key, value in arrays().items()}
    path = npz(tmp_path, video=np.array([1, 0, 1]), index=np.array([0, 1, 1]), **content)
    geometry = NpzGeometry(path)(*captures(), tmp_path)
    assert [view.key for view in geometry.views] == [("before", 1), ("after", 0), ("after", 1)]
    for view, pose in zip(geometry.views, POSES[1:], strict=True):
        np.testing.assert_allclose(view.cam_from_world, pose, atol=1e-12)
    (missing,) = geometry.unregistered
    assert (missing.video, missing.index) == ("before", 0)
    assert "known.npz" in missing.reason


def test_npz_confidence_is_kept_between_0_and_1(tmp_path: Path) -> None:
    confidence = np.full((4, HEIGHT, WIDTH), 0.25)
    confidence[:, :, WIDTH // 2 :] = 7.0
    path = npz(tmp_path, confidence=confidence, **arrays())
    view = NpzGeometry(path)(*captures(), tmp_path).views[0]
    assert view.confidence[-1, 0] == 0.25
    assert view.confidence[-1, -1] == 1.0
    assert view.confidence[0, 0] == 0.0  # unknown depth deserves no trust


def test_depth_of_zero_or_infinity_is_unknown(tmp_path: Path) -> None:
    content = arrays()
    content["depth"][:, -1, 0], content["depth"][:, -1, 1] = 0.0, np.inf
    content["depth"][:, -1, 2] = -1.0
    view = NpzGeometry(npz(tmp_path, **content))(*captures(), tmp_path).views[0]
    assert np.isnan(view.depth[-1, :3]).all()
    assert not view.measured[-1, :3].any()


def mirrored() -> np.ndarray:
    return np.stack([np.diag([-1.0, 1, 1, 1])] * 4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth": None}, "lacks depth"),
        ({"depth": np.ones((HEIGHT, WIDTH))}, "do not fit together"),
        ({"intrinsics": np.ones((3, 3, 3))}, "do not fit together"),
        ({"intrinsics": np.ones((4, 3, 3))}, "intrinsics of before frame 0"),
        ({"cam_from_world": 2 * np.stack(POSES)}, "not a rigid transform"),
        ({"cam_from_world": mirrored()}, "not a rigid transform"),
        ({"cam_from_world": np.full((4, 4, 4), np.nan)}, "finite 3x4 or 4x4"),
        ({"confidence": np.ones((4, 2, 2))}, "do not fit together"),
        ({"video": np.zeros(4)}, "both of video and index"),
        ({"video": np.array([0, 0, 1, 2]), "index": np.arange(4)}, "must be 0 / 1"),
        ({"video": np.array([0, 0, 1, 1]), "index": np.zeros(4, int)}, "names a frame twice"),
        ({"video": np.zeros(4, int), "index": np.arange(4)}, "any frame of the after"),
        ({"depth": np.ones((4, HEIGHT, 2 * WIDTH))}, "must cover the whole picture"),
    ],
)
def test_faulty_npz_is_named(
    change: dict[str, np.ndarray | None], message: str, tmp_path: Path
) -> None:
    content = {k: v for k, v in (arrays() | change).items() if v is not None}
    with pytest.raises(InputError, match=message):
        NpzGeometry(npz(tmp_path, **content))(*captures(), tmp_path)


def test_frame_counts_must_match_without_video_and_index(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"4 rows, but the captures have 3 \+ 3 frames"):
        NpzGeometry(npz(tmp_path, **arrays()))(*captures(3), tmp_path)


def test_pickles_are_not_loaded(tmp_path: Path) -> None:
    path = npz(tmp_path, depth=np.array([{"a": 1}], dtype=object))
    with pytest.raises(InputError, match="pickled objects are not allowed"):
        NpzGeometry(path)(*captures(), tmp_path)
    path.write_bytes(b"not a zip")
    with pytest.raises(InputError, match="cannot be read"):
        NpzGeometry(path)(*captures(), tmp_path)


def colmap_project(folder: Path, distortion: tuple[float, ...] = (0, 0, 0, 0)) -> SparseModel:
    lens = Lens(WIDTH, HEIGHT, INTRINSICS, np.array(distortion, float))
    names = [f"before/{i:05d}.png" for i in range(2)] + ["after0.color.png", "after1.color.png"]
    ordered = sorted(zip(names, POSES, strict=True))
    pictures = tuple(PosedPicture(name, lens, pose) for name, pose in ordered)
    xyz, rgb = np.array([[0.0, 0, 3]]), np.zeros((1, 3), np.uint8)
    observations = np.array([[0, 0], [0, 1], [0, 2]])
    model = SparseModel(pictures, SparsePoints(xyz, rgb, observations), float("nan"))
    write_model(model, folder / "sparse")
    for picture in pictures:
        path = folder / "depth" / f"{picture.name}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, wall_depth())
    return model


def test_colmap_project_with_depth_maps(tmp_path: Path) -> None:
    colmap_project(tmp_path)
    geometry = KnownGeometry(tmp_path, long_side=WIDTH)(*captures(), tmp_path)
    assert len(geometry.views) == 4
    for view, pose in zip(geometry.views, POSES, strict=True):
        np.testing.assert_allclose(view.cam_from_world, pose, atol=1e-9)
        np.testing.assert_array_equal(view.depth, wall_depth())
    # sorted by name, the model has after0, after1, before 0: in the captures' order 2, 3, 0
    assert geometry.points.observations.tolist() == [[0, 2], [0, 3], [0, 0]]


def test_colmap_lens_distortion_bends_picture_and_depth_alike(tmp_path: Path) -> None:
    colmap_project(tmp_path, (-0.1, 0, 0, 0))
    before, after = captures()
    ramp = np.broadcast_to(np.linspace(0, 255, WIDTH)[None, :, None], (HEIGHT, WIDTH, 3))
    ramp = np.rint(ramp).astype(np.uint8)
    before = Capture("before", "", tuple(replace(f, image=ramp) for f in before.frames))
    np.save(tmp_path / "depth/before/00000.png.npy", 1 + ramp[..., 0] / np.float32(255))
    view = ColmapGeometry(tmp_path, long_side=WIDTH)(before, after, tmp_path).views[0]
    inner = (slice(10, -10), slice(10, -10))
    assert np.abs(view.image[inner][..., 0] - ramp[inner][..., 0].astype(float)).max() > 2
    np.testing.assert_allclose(view.depth[inner], 1 + view.image[inner][..., 0] / 255, atol=0.01)


def test_colmap_names_that_both_captures_have_are_ambiguous(tmp_path: Path) -> None:
    colmap_project(tmp_path)
    before, after = captures()
    same = tuple(replace(f, name=g.name) for f, g in zip(before.frames, after.frames, strict=True))
    with pytest.raises(InputError, match="any frame of the after capture"):
        ColmapGeometry(tmp_path)(Capture("before", "", same), after, tmp_path)


def test_colmap_without_depth_map_is_named(tmp_path: Path) -> None:
    colmap_project(tmp_path)
    (tmp_path / "depth/after1.color.png.npy").unlink()
    with pytest.raises(InputError, match=r"No depth map for after1\.color\.png"):
        ColmapGeometry(tmp_path)(*captures(), tmp_path)


def test_colmap_binary_depth_map(tmp_path: Path) -> None:
    """A map written by hand in COLMAP's format: text header, then rows of little-endian floats."""
    path = tmp_path / "a.png.geometric.bin"
    values = np.arange(6, dtype="<f4").reshape(2, 3)
    path.write_bytes(b"3&2&1&" + values.tobytes())
    depth, confidence = read_depth(path)
    np.testing.assert_array_equal(depth, values)
    assert confidence is None
    path.write_bytes(b"3&2&1&" + values.tobytes()[:-4])
    with pytest.raises(InputError, match="not a COLMAP depth map"):
        read_depth(path)


def seven_scenes(folder: Path) -> None:
    """before/ and after/ with two frames each; millimetres, 65535 = no reading."""
    for video, poses in (("before", POSES[:2]), ("after", POSES[2:])):
        (folder / video).mkdir()
        for i, pose in enumerate(poses):
            depth = np.rint(np.nan_to_num(wall_depth(), nan=65.535) * 1000).astype(np.uint16)
            cv2.imwrite(str(folder / video / f"{video}{i}.depth.png"), depth)
            np.savetxt(folder / video / f"{video}{i}.pose.txt", world_from_cam(pose))
    np.savetxt(folder / "camera-intrinsics.txt", INTRINSICS)


def test_seven_scenes_folder(tmp_path: Path) -> None:
    seven_scenes(tmp_path)
    geometry = KnownGeometry(tmp_path, long_side=WIDTH)(*captures(), tmp_path)
    for view, pose in zip(geometry.views, POSES, strict=True):
        np.testing.assert_allclose(view.cam_from_world, pose, atol=1e-9)
        np.testing.assert_allclose(view.lens.intrinsics, INTRINSICS)
        np.testing.assert_allclose(view.depth, wall_depth(), atol=5.1e-4)


def test_frame_without_pose_is_unregistered(tmp_path: Path) -> None:
    seven_scenes(tmp_path)
    (tmp_path / "after/after0.pose.txt").unlink()
    geometry = RgbdGeometry(tmp_path)(*captures(), tmp_path)
    assert [(u.video, u.index) for u in geometry.unregistered] == [("after", 0)]


def test_missing_intrinsics_are_asked_for(tmp_path: Path) -> None:
    seven_scenes(tmp_path)
    (tmp_path / "camera-intrinsics.txt").unlink()
    with pytest.raises(InputError, match=r"camera-intrinsics\.txt"):
        RgbdGeometry(tmp_path)(*captures(), tmp_path)
    given = RgbdGeometry(tmp_path, intrinsics=(300.0, 300.0, 160.0, 120.0))
    assert len(given(*captures(), tmp_path).views) == 4


def test_tum_folder(tmp_path: Path) -> None:
    """Pose and depth by nearest time; a quarter turn about y as quaternion (0, s, 0, s)."""
    s = np.sqrt(0.5)
    (tmp_path / "groundtruth.txt").write_text(
        f"# time tx ty tz qx qy qz qw\n10.00 1 2 3 0 0 0 1\n20.01 1 2 3 0 {s} 0 {s}\n"
    )
    (tmp_path / "depth.txt").write_text("# time file\n10.01 a.png\n20.00 b.png\n")
    for name, metres in (("a", 1.0), ("b", 2.0)):
        picture = np.full((HEIGHT, WIDTH), 5000 * metres, np.uint16)
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture)
    np.savetxt(tmp_path / "camera-intrinsics.txt", INTRINSICS)
    (b0, b1), (a0, a1) = (c.frames for c in captures())
    before = Capture("before", "", (replace(b0, name="10.0.png"), replace(b1, name="99.0.png")))
    after = Capture("after", "", (replace(a0, name="20.0.png"), replace(a1, name="19.9.png")))
    geometry = KnownGeometry(tmp_path, depth_scale=5000)(before, after, tmp_path)
    assert [view.key for view in geometry.views] == [("before", 0), ("after", 0)]
    assert [float(view.depth[0, 0]) for view in geometry.views] == [1.0, 2.0]
    to_world = world_from_cam(geometry.views[1].cam_from_world)
    np.testing.assert_allclose(to_world[:3, 3], [1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(to_world[:3, 2], [1, 0, 0], atol=1e-12)  # looks along world x


def test_a_folder_of_no_known_kind_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no known geometry"):
        KnownGeometry(tmp_path)(*captures(), tmp_path)
    with pytest.raises(InputError, match=r"neither an \.npz nor a folder"):
        KnownGeometry(tmp_path / "absent")(*captures(), tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        KnownGeometry(tmp_path / "absent.npz")(*captures(), tmp_path)


def test_real_depth_camera_folder(real_data: Path, tmp_path: Path) -> None:
    """Two frames of 7-Scenes RedKitchen: depth carried to the other camera fits its depth."""
    folder = real_data / "redkitchen_rgbd"

    def of(video: Video, stem: str) -> Capture:
        image = cv2.imread(str(folder / f"{stem}.color.jpg"))[..., ::-1].copy()
        frame = Frame(video, 0, f"{stem}.color.jpg", None, image, 640, 480)
        return Capture(video, str(folder), (frame,))

    pair = of("before", "frame-000000"), of("after", "frame-000025")
    first, second = KnownGeometry(folder, long_side=320)(*pair, tmp_path).views
    from scenediff_classic.cameras import project, sample, unproject

    xy, z = project(unproject(first), second.intrinsics, second.cam_from_world)
    seen = sample(second.depth, np.nan_to_num(xy, nan=-1), nearest=True)
    ratio = seen[first.measured] / z[first.measured]
    assert np.median(np.abs(ratio[np.isfinite(ratio)] - 1)) < 0.02
