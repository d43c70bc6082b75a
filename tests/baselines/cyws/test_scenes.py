"""Rendered scenes: boxes of what is there and of what is not, kept and read back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines.cyws import scenes
from baselines.cyws.pairs import (
    LEAST_PIXELS,
    augmented,
    batched,
    drawn_pair,
    judged_pairs,
    mirrored,
    noisy_depth,
    pair_of,
)
from baselines.cyws.rendered_folders import read_rendered, resized, with_geometry
from baselines.cyws.scenes import (
    RenderScenes,
    SceneFrames,
    Sites,
    read_shards,
    render_scene,
    write_shard,
)
from data_tools.synthetic_pairs.export import write_pair
from data_tools.synthetic_pairs.scene import PairSpec, compose
from data_tools.synthetic_pairs.tracer import Tracer
from scenediff_classic.errors import InputError
from scenediff_classic.types import Geometry, SparsePoints

SPEC = PairSpec(
    "x", 7, frames=2, width=96, height=64, close=True, kinds=("removed", "moved"), texture_size=256
)


@pytest.fixture(scope="module")
def scene() -> SceneFrames:
    return render_scene(SPEC)


def test_a_scene_has_a_site_for_each_place(scene: SceneFrames) -> None:
    assert sorted(scene.present) == [0, 0, 1]  # removed; moved: old and new place
    assert scene.images.shape == (4, 64, 96, 3)
    assert scene.video.tolist() == [0, 0, 1, 1]
    wide, high = (
        scene.boxes[..., 2] - scene.boxes[..., 0],
        scene.boxes[..., 3] - scene.boxes[..., 1],
    )
    assert (scene.pixels <= wide * high).all()
    assert (scene.pixels.max(1) > LEAST_PIXELS).all()
    again = render_scene(SPEC)
    assert np.array_equal(scene.images, again.images)
    assert np.array_equal(scene.boxes, again.boxes)


def test_absent_things_are_boxed_where_they_would_be_seen() -> None:
    composed = compose(replace(SPEC, kinds=("removed",)))
    (gone,) = (item for item in composed.items if item.kind)
    assert gone.before is not None
    sites = Sites(composed)
    assert sites.present.tolist() == [0]
    for camera in composed.after.cameras:
        boxes, pixels = sites.boxes("after", camera)
        as_if = [*composed.things("after"), (999, gone.standing(gone.before))]
        mask = Tracer(as_if).identify(camera) == 999
        assert pixels[0] == mask.sum()
        rows, columns = np.nonzero(mask)
        assert boxes[0].tolist() == [
            columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
        ]  # fmt: skip
        assert not (Tracer(composed.things("after")).identify(camera) == gone.id).any()


def test_shards_keep_scenes(scene: SceneFrames, tmp_path: Path) -> None:
    none = replace(scene, present=scene.present[:0], boxes=scene.boxes[:0], pixels=scene.pixels[:0])
    write_shard(tmp_path / "00000.npz", [scene, none])
    write_shard(tmp_path / "00001.npz", [scene])
    one, two, three = read_shards(tmp_path)
    for found, want in ((one, scene), (two, none), (three, scene)):
        assert np.array_equal(found.images, want.images)
        assert np.array_equal(found.boxes, want.boxes)
        assert np.array_equal(found.pixels, want.pixels)
        np.testing.assert_allclose(found.depth, want.depth, rtol=1e-3)
    assert len(read_shards(tmp_path, 1)) == 1
    (tmp_path / "00001.npz").write_bytes(b"PK")
    with pytest.raises(InputError, match="damaged"):
        read_shards(tmp_path)
    with pytest.raises(InputError, match="no rendered scenes"):
        read_shards(tmp_path / "none")


def test_missing_shards_alone_are_rendered(
    scene: SceneFrames, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[PairSpec] = []

    def fake(spec: PairSpec) -> SceneFrames:
        asked.append(spec)
        return scene

    monkeypatch.setattr(scenes, "render_scene", fake)
    render = RenderScenes(tmp_path, "test", scenes=20, frames=2)
    shards = render()
    assert len(shards) == 2
    assert len(asked) == 32
    assert len({spec.seed for spec in asked}) == 32
    assert all(spec.held_out for spec in asked)
    shards[1].unlink()
    render()
    assert len(asked) == 48
    train = {RenderScenes(tmp_path, "train").spec(k).seed for k in range(100)}
    assert not train & {spec.seed for spec in asked}
    with pytest.raises(InputError, match="at least"):
        RenderScenes(tmp_path, scenes=0)()


# --- pairs --------------------------------------------------------------------------------------


def test_pairs_of_both_captures_show_changes(scene: SceneFrames) -> None:
    both = pair_of(scene, 0, 3)
    seen = (scene.pixels[:, [0, 3]] >= LEAST_PIXELS).all(1)
    assert np.array_equal(both.boxes, scene.boxes[seen][:, [0, 3]])
    assert len(both.boxes)
    assert len(pair_of(scene, 0, 1).boxes) == 0  # one capture: nothing differs
    assert both.turn == pytest.approx(pair_of(scene, 3, 0).turn)


def test_judged_pairs_are_always_the_same(scene: SceneFrames) -> None:
    first, second = judged_pairs([scene, scene], 3), judged_pairs([scene, scene], 3)
    assert len(first) == 6
    for a, b in zip(first, second, strict=True):
        assert np.array_equal(a.images, b.images)
    assert len(judged_pairs([scene], 99)) == 4


def test_the_mirror_keeps_geometry_and_boxes(scene: SceneFrames) -> None:
    pair = pair_of(scene, 0, 2)
    twice = mirrored(mirrored(pair))
    assert np.array_equal(twice.images, pair.images)
    np.testing.assert_allclose(twice.cam_from_world, pair.cam_from_world)
    np.testing.assert_allclose(twice.boxes, pair.boxes)
    places = np.array([[0.4, 0.6], [0.55, 0.7]])
    straight = batched([pair]).registration.carry(0, 0, places)
    flipped = batched([mirrored(pair)]).registration.carry(0, 0, [1, 0] - places * [1, -1])
    np.testing.assert_allclose(flipped, [1, 0] - straight * [1, -1], atol=1e-5)


def test_augmentation_depends_on_the_generator_alone(scene: SceneFrames) -> None:
    one, two = (
        augmented(drawn_pair([scene], rng), rng)
        for rng in (np.random.default_rng(4), np.random.default_rng(4))
    )
    assert np.array_equal(one.images, two.images)
    assert np.array_equal(one.depth, two.depth, equal_nan=True)
    assert np.array_equal(one.cam_from_world, two.cam_from_world)


def test_depth_noise_is_small(scene: SceneFrames) -> None:
    noisy = noisy_depth(scene.depth[0], np.random.default_rng(0))
    off = np.abs(noisy / scene.depth[0] - 1)
    assert 0.003 < np.nanmedian(off) < 0.03


def test_registered_pictures_agree(scene: SceneFrames) -> None:
    batch = batched([pair_of(scene, 0, 1)])
    onto, _ = batch.registration.splat(64, 96)
    drawn = onto.draw(batch.images[:, 1].flatten(2))
    seen = onto.visibility[0, 0] > 0.9
    registered = (drawn - batch.images[:, 0])[0, :, seen].abs().mean()
    plain = (batch.images[:, 1] - batch.images[:, 0])[0, :, seen].abs().mean()
    assert seen.float().mean() > 0.5
    assert registered < 0.6 * plain


# --- rendered folders ---------------------------------------------------------------------------


def test_rendered_pairs_have_the_same_truth(tmp_path: Path) -> None:
    write_pair(SPEC, tmp_path)
    found = read_rendered(tmp_path / "x")
    assert found.images.shape == (4, 64, 96, 3)
    assert sorted(found.present) == [0, 0, 1]
    stored = np.load(tmp_path / "x" / "truth_instances.npz")
    (moved,) = stored["id"][stored["kind"] == "moved"]
    (removed,) = stored["id"][stored["kind"] == "removed"]
    counts = [[int((m == i).sum()) for m in stored["instances"]] for i in (moved, removed)]
    there = {tuple(found.pixels[k, found.video == v]) for k, v in enumerate(found.present)}
    assert there == {tuple(counts[0][:2]), tuple(counts[0][2:]), tuple(counts[1][:2])}
    half = resized(found, 32, 48)
    np.testing.assert_allclose(half.boxes, found.boxes / 2)
    np.testing.assert_allclose(half.intrinsics[:, :2], found.intrinsics[:, :2] / 2)
    quick = read_rendered(tmp_path / "x", (32, 48))  # traced at that size
    assert np.array_equal(quick.images, half.images)
    assert np.array_equal(quick.depth, half.depth, equal_nan=True)
    np.testing.assert_allclose(quick.intrinsics, half.intrinsics)
    seen = half.pixels > 8
    assert seen.sum() >= 6
    off = np.abs(quick.boxes - half.boxes)[seen]
    assert np.median(off) <= 0.5
    assert (off <= 1).mean() > 0.9  # so small, thin parts may be missed
    np.testing.assert_allclose(quick.pixels[seen], half.pixels[seen], rtol=0.3)
    nothing = with_geometry(found, Geometry((), SparsePoints.none()))
    assert np.isnan(nothing.depth).all()
    with pytest.raises(InputError, match="no rendered pair"):
        read_rendered(tmp_path)
