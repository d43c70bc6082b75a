"""A pair on disk: layout, agreement of masks, depth and pictures, and repeatability."""

import json
import re
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from data_tools.synthetic_pairs.__main__ import Options, main, specs_of
from data_tools.synthetic_pairs.export import annotate, shoot, write_pair
from data_tools.synthetic_pairs.scene import PairSpec, Scene, compose
from data_tools.synthetic_pairs.splits import split_specs
from scenediff_classic import masks
from scenediff_classic.cameras import inside, pixel_centres, project, sample, world_from_cam
from scenediff_classic.dataset import read_annotations
from scenediff_classic.errors import OutputError
from scenediff_classic.types import VIDEOS

SPEC = PairSpec(
    "small", 100, frames=3, width=128, height=96, close=True, texture_size=256,
    kinds=("added", "removed", "moved"),
)  # fmt: skip


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("pairs")
    assert write_pair(SPEC, root)
    return root / "small"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return compose(SPEC)


def test_the_folder_has_the_benchmark_layout(pair: Path) -> None:
    assert {p.name for p in pair.iterdir()} == {
        "original_video1.mp4", "original_video2.mp4", "before", "after", "segments.pkl",
        "segments.json", "metadata.json", "truth_geometry.npz", "truth_instances.npz",
    }  # fmt: skip
    names = ["0000.png", "0001.png", "0002.png"]
    for video in VIDEOS:
        assert sorted(p.name for p in (pair / video).iterdir()) == names
    assert json.loads((pair / "metadata.json").read_text())["seed"] == 100
    assert not list(pair.parent.glob(".*"))


def test_both_forms_of_the_annotation_agree(pair: Path) -> None:
    first = read_annotations(pair / "segments.json")
    second = read_annotations(pair / "segments.pkl")
    assert first == second
    assert sorted(str(o.kind) for o in first.objects) == ["added", "moved", "removed"]
    assert all(re.fullmatch(r"[a-z]+_\d+", o.label) for o in first.objects)


def test_masks_are_the_visible_pixels_of_what_changed(pair: Path) -> None:
    truth = np.load(pair / "truth_instances.npz")
    annotation = read_annotations(pair)
    kinds = dict(zip(truth["id"].tolist(), truth["kind"].tolist(), strict=True))
    assert {o.object_id: o.kind for o in annotation.objects} == {
        k: v for k, v in kinds.items() if v not in ("fixed", "unchanged")
    }
    for instances, number, index in zip(
        truth["instances"], truth["video"], truth["index"], strict=True
    ):
        video = VIDEOS[number]
        for item in annotation.objects:
            expected = instances == item.object_id
            track = annotation.track(video, item.object_id)
            here = [m for m in track.masks if m.frame == 30 * index] if track else []
            assert len(here) == bool(expected.any())
            if here:
                np.testing.assert_array_equal(masks.decode(here[0].mask), expected)
            if not item.present(video):
                assert not expected.any()
        assert set(np.unique(instances)) <= {0, *kinds}


def test_frames_of_the_video_are_the_pictures_at_whole_seconds(pair: Path) -> None:
    for number, video in enumerate(VIDEOS, start=1):
        with av.open(str(pair / f"original_video{number}.mp4")) as container:
            frames = list(container.decode(video=0))
        assert [float(f.time) for f in frames] == [0.0, 1.0, 2.0]
        for index, frame in enumerate(frames):
            picture = np.asarray(Image.open(pair / video / f"{index:04d}.png")).astype(float)
            error = np.abs(frame.to_ndarray(format="rgb24") - picture)
            assert error.mean() < 6


def test_depth_and_poses_carry_one_view_onto_the_next(pair: Path) -> None:
    geometry, truth = np.load(pair / "truth_geometry.npz"), np.load(pair / "truth_instances.npz")
    depth, poses, k = geometry["depth"], geometry["cam_from_world"], geometry["intrinsics"]
    assert depth.dtype == np.float32
    height, width = depth.shape[1:]
    centres = pixel_centres(height, width).reshape(-1, 2)
    rays = np.c_[(centres - k[0][:2, 2]) / k[0][0, 0], np.ones(len(centres))]
    world = (rays * depth[0].reshape(-1, 1)) @ world_from_cam(poses[0])[:3, :3].T
    world += world_from_cam(poses[0])[:3, 3]
    xy, z = project(world, k[1], poses[1])
    seen = sample(depth[1], xy[None], nearest=True)[0]
    agree = inside(xy, height, width) & (np.abs(seen - z) < 0.01 * z)
    # The same room from 9 degrees aside: most that lies inside the picture is seen by both.
    assert agree.mean() > 0.5
    there = sample(truth["instances"][1].astype(np.float32), xy[None], nearest=True)[0]
    same = there == truth["instances"][0].reshape(-1)
    assert same[agree].mean() > 0.97


def test_geometry_rows_are_named_by_capture_and_frame(pair: Path) -> None:
    for name in ("truth_geometry.npz", "truth_instances.npz"):
        content = np.load(pair / name)
        assert content["video"].tolist() == [0, 0, 0, 1, 1, 1]
        assert content["index"].tolist() == [0, 1, 2, 0, 1, 2]
    assert (np.load(pair / "truth_geometry.npz")["confidence"] == 1).all()


def test_a_finished_pair_is_left_alone(pair: Path) -> None:
    stamp = (pair / "metadata.json").stat().st_mtime_ns
    assert not write_pair(SPEC, pair.parent)
    assert (pair / "metadata.json").stat().st_mtime_ns == stamp


def test_rendering_again_gives_the_same_bytes(pair: Path, tmp_path: Path) -> None:
    (tmp_path / ".small.part").mkdir()  # as a killed run leaves it
    assert write_pair(SPEC, tmp_path)
    for path in sorted(pair.rglob("*")):
        if path.is_file() and path.suffix != ".npz":  # archives hold the time of writing
            assert path.read_bytes() == (tmp_path / path.relative_to(pair.parent)).read_bytes()
    for name in ("truth_geometry.npz", "truth_instances.npz"):
        first, second = np.load(pair / name), np.load(tmp_path / "small" / name)
        for key in first.files:
            np.testing.assert_array_equal(first[key], second[key])


def test_frames_without_a_pixel_of_the_object_are_left_out(scene: Scene) -> None:
    shots = shoot(scene)
    item = next(item for item in scene.items if item.kind == "removed")
    emptied = replace(
        shots[1].truth, instances=np.where(shots[1].truth.instances == item.id, 0,
                                           shots[1].truth.instances).astype(np.uint16)
    )  # fmt: skip
    shots[1] = replace(shots[1], truth=emptied)
    track = annotate(scene, shots).track("before", item.id)
    assert track is not None
    assert 30 not in [mask.frame for mask in track.masks]


def test_an_unwritable_folder_is_reported(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    with pytest.raises(OutputError, match="Cannot write"):
        write_pair(SPEC, blocked)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--scenes", "0"], "--scenes must be at least 1"),
        (["--frames", "1"], "--frames at least 2"),
        (["--width", "63"], "even and at least 64"),
        (["--seed", "-1"], "must not be negative"),
    ],
)
def test_bad_options_end_with_one_sentence(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments, "-o", str(tmp_path / "out")]) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_split_can_be_cut_short() -> None:
    assert specs_of(Options(Path("out"), split="tiny", scenes=1)) == split_specs("tiny")[:1]
    assert len(specs_of(Options(Path("out"), split="test"))) == 24
    assert len(specs_of(Options(Path("out")))) == 10
