"""Registration on drawn pictures with known cameras, and every way in which it must refuse."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_tools.benchmarks.registration import compare_cameras, read_true_cameras
from data_tools.synthetic_pairs.export import write_pair
from data_tools.synthetic_pairs.splits import numbered_specs
from scenediff_classic.cameras import camera_centre
from scenediff_classic.errors import AlignmentError, OutputError
from scenediff_classic.geometry.registration import pairing, placement
from scenediff_classic.geometry.registration.colmap.database import Database
from scenediff_classic.geometry.registration.colmap.models import read_model
from scenediff_classic.geometry.registration.structure_from_motion import StructureFromMotion
from scenediff_classic.types import Capture, Geometry
from scenediff_classic.video import read_capture
from tests.geometry.cards import (
    FOCAL,
    HEIGHT,
    WIDTH,
    capture,
    files_in,
    look,
    similarity_residual,
    sweep,
)

POSES_BEFORE, POSES_AFTER = sweep(3), sweep(3, y=-0.3, z=0.4)
SFM = StructureFromMotion(long_side=160, attempts=1)
ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def before() -> Capture:
    return capture("before", POSES_BEFORE)


@pytest.fixture(scope="module")
def after() -> Capture:
    return capture("after", POSES_AFTER)


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sfm")


@pytest.fixture(scope="module")
def geometry(before: Capture, after: Capture, workspace: Path) -> Geometry:
    return SFM(before, after, workspace)


def as_after(before: Capture) -> Capture:
    frames = tuple(replace(frame, video="after") for frame in before.frames)
    return Capture("after", "copy", frames)


def test_cameras_agree_with_the_truth(geometry: Geometry) -> None:
    assert [view.key for view in geometry.views] == [
        (video, i) for video in ("before", "after") for i in range(3)
    ]
    found = np.array([camera_centre(view.cam_from_world) for view in geometry.views])
    true = np.array([camera_centre(pose) for pose in POSES_BEFORE + POSES_AFTER])
    assert similarity_residual(found, true) < 0.01
    for view in geometry.views:
        assert view.lens.intrinsics[0, 0] == pytest.approx(FOCAL, rel=0.02)
        assert (view.lens.width, view.lens.height) == (WIDTH, HEIGHT)


def test_views_have_no_depth_yet(geometry: Geometry) -> None:
    for view in geometry.views:
        assert view.shape == (120, 160)
        assert view.image.dtype == np.uint8
        assert view.intrinsics[0, 0] == pytest.approx(view.lens.intrinsics[0, 0] / 2)
        assert np.isnan(view.depth).all()
        assert not view.measured.any()
        assert not view.confidence.any()
        assert view.ignore.mean() < 0.02


def test_points_project_to_where_their_colour_is(geometry: Geometry) -> None:
    points, positions = geometry.points.observations.T
    assert len(geometry.points.xyz) > 200
    assert set(positions) == set(range(6))
    for number, view in enumerate(geometry.views):
        xyz = geometry.points.xyz[points[positions == number]]
        cam = xyz @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
        xy = (cam @ view.intrinsics.T)[:, :2] / cam[:, 2:]
        assert (cam[:, 2] > 0).all()
        inside = (xy > -1).all(axis=1) & (xy < [161, 121]).all(axis=1)
        assert inside.all()


def test_model_opens_in_colmap(geometry: Geometry, workspace: Path) -> None:
    model = read_model(workspace / "sparse")
    assert [picture.name for picture in model.pictures][:4] == [
        "after/00000.png", "after/00001.png", "after/00002.png", "before/00000.png",
    ]  # fmt: skip
    assert (workspace / "sfm/images/before/00000.png").is_file()


def test_second_call_reuses_finished_work(
    geometry: Geometry,
    before: Capture,
    after: Capture,
    workspace: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    files = files_in(workspace)
    monkeypatch.setattr(Database, "reconstruct", None)  # calling it would fail
    again = StructureFromMotion(long_side=320, attempts=1)(before, after, workspace)
    assert files_in(workspace) == files
    assert again.log == geometry.log
    assert [view.placement for view in again.views] == [view.placement for view in geometry.views]
    assert again.views[0].shape == (240, 320)
    np.testing.assert_array_equal(again.views[0].cam_from_world, geometry.views[0].cam_from_world)


def test_same_seed_gives_the_same_cameras(
    geometry: Geometry, before: Capture, after: Capture, tmp_path: Path
) -> None:
    again = SFM(before, after, tmp_path)
    for one, other in zip(geometry.views, again.views, strict=True):
        np.testing.assert_array_equal(one.cam_from_world, other.cam_from_world)
        np.testing.assert_array_equal(one.lens.intrinsics, other.lens.intrinsics)
    np.testing.assert_array_equal(geometry.points.xyz, again.points.xyz)


def test_frames_say_how_firmly_they_are_placed(geometry: Geometry) -> None:
    assert geometry.warnings == ()
    assert geometry.bridge is not None
    assert geometry.bridge > 100
    for view in geometry.views:
        assert view.placement is not None
        assert view.placement.confidence > 0.6
        assert 0 < view.placement.error_px < 1
        assert view.placement.shared <= view.placement.points
        assert view.placement.agreement is not None
        assert view.placement.agreement > 0.9


def test_frames_of_low_confidence_are_named(
    geometry: Geometry, before: Capture, after: Capture, workspace: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(placement, "LOW_CONFIDENCE", 2.0)
    (warning,) = SFM(before, after, workspace).warnings
    assert warning.startswith("6 frames were placed with low confidence")
    assert "before 0 (0." in warning
    assert "after 2 (0." in warning


def test_cameras_do_not_depend_on_the_path_or_the_process(tmp_path: Path) -> None:
    """Bit for bit: stereo would amplify the least difference."""
    program = (
        "import sys, pathlib, numpy as np;"
        "from tests.geometry.cards import capture;"
        "from tests.geometry.registration.test_structure_from_motion import"
        " POSES_AFTER, POSES_BEFORE, SFM;"
        "g = SFM(capture('before', POSES_BEFORE), capture('after', POSES_AFTER),"
        " pathlib.Path(sys.argv[1]));"
        "np.save(sys.argv[1] + '/out.npy', np.concatenate([g.points.xyz.ravel(),"
        " *(v.cam_from_world.ravel() for v in g.views), *(v.intrinsics.ravel() for v in g.views)]))"
    )
    found = []
    for name in ("a", "another/folder/with/a/longer/name"):
        folder = tmp_path / name
        folder.mkdir(parents=True)
        subprocess.run([sys.executable, "-c", program, str(folder)], check=True, cwd=ROOT)
        found.append((folder / "out.npy").read_bytes())
    assert found[0] == found[1]


@pytest.mark.slow
def test_the_room_wins_where_much_of_it_moves_as_one(tmp_path: Path) -> None:
    """Table, rug and all on them: 29 % of the pixels. The joint model bends by 9 % of the path."""
    (spec,) = numbered_specs(1, 0, 8, 480, 360, (), rigid_motion=1)
    write_pair(spec, tmp_path)
    folder = tmp_path / spec.name
    captures = read_capture(folder / "before", "before"), read_capture(folder / "after", "after")
    geometry = StructureFromMotion()(*captures, tmp_path / "work")
    assert any("ambiguous" in warning for warning in geometry.warnings)
    true = read_true_cameras(folder / "truth_geometry.npz", *captures)
    errors = compare_cameras(
        np.stack([view.cam_from_world for view in geometry.views]),
        np.stack([true[view.key] for view in geometry.views]),
    )
    assert len(geometry.views) == 16
    assert errors.centre.max() < 0.01 * errors.extent


def test_lens_describes_the_input_picture(before: Capture, after: Capture, tmp_path: Path) -> None:
    """The frames in memory are half the size of the files they came from."""
    halved = [
        Capture(c.video, c.source, (replace(c.frames[n], width=2 * WIDTH, height=2 * HEIGHT),))
        for c, n in ((before, 0), (after, 1))
    ]
    found = StructureFromMotion(long_side=160)(*halved, tmp_path)
    for view in found.views:
        assert (view.lens.width, view.lens.height) == (2 * WIDTH, 2 * HEIGHT)
        assert view.lens.intrinsics[0, 2] == WIDTH
        np.testing.assert_allclose(view.intrinsics[0, 0] * 4, view.lens.intrinsics[0, 0])


def test_two_views_and_exif_focal(before: Capture, after: Capture, tmp_path: Path) -> None:
    single = [
        Capture(c.video, c.source, (replace(c.frames[n], index=0, focal_px=FOCAL),))
        for c, n in ((before, 0), (after, 1))
    ]
    geometry = SFM(*single, tmp_path)
    assert [view.lens.intrinsics[0, 0] for view in geometry.views] == [FOCAL, FOCAL]
    relative = geometry.views[1].cam_from_world @ np.linalg.inv(geometry.views[0].cam_from_world)
    true = POSES_AFTER[1] @ np.linalg.inv(POSES_BEFORE[0])
    np.testing.assert_allclose(relative[:3, :3], true[:3, :3], atol=0.01)
    direction = relative[:3, 3] / np.linalg.norm(relative[:3, 3])
    np.testing.assert_allclose(direction, true[:3, 3] / np.linalg.norm(true[:3, 3]), atol=0.05)


def test_dynamic_content_gives_no_features(before: Capture, after: Capture, tmp_path: Path) -> None:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[:, : WIDTH // 2] = True
    masked = Capture("before", "masked", tuple(replace(f, ignore=mask) for f in before.frames[:1]))
    geometry = SFM(masked, Capture("after", "", after.frames[1:2]), tmp_path)
    view = geometry.views[0]
    assert view.ignore[:, :78].all()
    assert not view.ignore[:, 82:].any()
    cam = geometry.points.xyz @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
    x = (cam @ view.intrinsics.T)[:, 0] / cam[:, 2]
    assert x.min() > 79


def test_blank_frame_is_listed_with_its_reason(
    before: Capture, after: Capture, tmp_path: Path
) -> None:
    blank = replace(after.frames[2], image=np.full((HEIGHT, WIDTH, 3), 20, np.uint8))
    geometry = SFM(before, Capture("after", "", (*after.frames[:2], blank)), tmp_path)
    (missing,) = geometry.unregistered
    assert (missing.video, missing.index) == ("after", 2)
    assert "only 0 features" in missing.reason
    assert len(geometry.views) == 5


def test_identical_frames_are_refused(before: Capture, tmp_path: Path) -> None:
    same = Capture("before", "", tuple(replace(before.frames[0], index=i) for i in range(3)))
    with pytest.raises(AlignmentError, match="the same picture"):
        SFM(same, as_after(same), tmp_path)


def test_a_camera_that_stands_still_is_refused(before: Capture, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frames = tuple(
        replace(
            before.frames[0],
            index=i,
            image=before.frames[0].image ^ rng.integers(0, 4, (HEIGHT, WIDTH, 3), np.uint8),
        )
        for i in range(2)
    )
    still = Capture("before", "", frames)
    noisy = Capture("after", "", (replace(frames[0], video="after", image=frames[0].image ^ 1),))
    with pytest.raises(AlignmentError, match="does not move"):
        SFM(still, noisy, tmp_path)


def test_a_camera_that_only_turns_is_refused(tmp_path: Path) -> None:
    turning = [look((0, 0, 0), angle) for angle in (-0.25, -0.1, 0.1)]
    captures = capture("before", turning[:2]), capture("after", turning[2:])
    with pytest.raises(AlignmentError, match="only turns on the spot"):
        SFM(*captures, tmp_path)


def test_captures_of_different_places_are_refused(before: Capture, tmp_path: Path) -> None:
    elsewhere = capture("after", POSES_AFTER[:2], seed=7)
    with pytest.raises(AlignmentError, match="could not be aligned: no frame of one shows"):
        SFM(before, elsewhere, tmp_path)
    assert not (tmp_path / "sparse").exists()


def test_a_blank_capture_is_refused(before: Capture, after: Capture, tmp_path: Path) -> None:
    grey = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
    blank = Capture("after", "", tuple(replace(f, image=grey) for f in after.frames))
    with pytest.raises(AlignmentError, match="no frame of after has enough texture"):
        SFM(before, blank, tmp_path)


def test_unwritable_workspace_is_named(before: Capture, after: Capture, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="file"):
        SFM(before, after, tmp_path / "file")


@pytest.mark.slow
def test_pairs_chosen_by_likeness_suffice(
    before: Capture, after: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The way of long videos, on few frames: not all pairs are matched, all are registered."""
    monkeypatch.setattr(pairing, "EXHAUSTIVE", 3)
    monkeypatch.setattr(pairing, "SIMILAR", 2)
    geometry = SFM(before, after, tmp_path)
    found = np.array([camera_centre(view.cam_from_world) for view in geometry.views])
    true = np.array([camera_centre(pose) for pose in POSES_BEFORE + POSES_AFTER])
    assert similarity_residual(found, true) < 0.01


@pytest.mark.slow
def test_the_same_recording_twice_gives_the_same_cameras(before: Capture, tmp_path: Path) -> None:
    geometry = SFM(before, as_after(before), tmp_path)
    for one, other in zip(geometry.of("before"), geometry.of("after"), strict=True):
        np.testing.assert_allclose(one.cam_from_world, other.cam_from_world, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["pots", "printing", "cantina", "playground"])
def test_real_photos_are_registered(scene: str, real_data: Path, tmp_path: Path) -> None:
    """5 + 5 wide-baseline phone photos, two sizes, no EXIF; playground looks all around."""
    folder = real_data / "paslcd_multiview" / scene
    before = read_capture(folder / "ref_same_light", "before")
    geometry = StructureFromMotion()(before, read_capture(folder / "after", "after"), tmp_path)
    assert len(geometry.views) >= (9 if scene == "playground" else 10)
    assert not [w for w in geometry.warnings if "low confidence" not in w]
