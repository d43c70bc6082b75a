"""Arrangements obey physics, and the named splits keep apart."""

from dataclasses import replace

import numpy as np
import pytest

from data_tools.synthetic_pairs.changes import GAP, MOVE_AT_LEAST, Item, Place, Wish, arrange
from data_tools.synthetic_pairs.meshes import box
from data_tools.synthetic_pairs.models import Material, Model, Part
from data_tools.synthetic_pairs.room import Room, Support, build_room
from data_tools.synthetic_pairs.scene import PairSpec, Scene, compose
from data_tools.synthetic_pairs.splits import numbered_specs, split_specs
from data_tools.synthetic_pairs.styles import TEST, VAL
from data_tools.synthetic_pairs.trajectory import cameras_along, plan_walks
from scenediff_classic.cameras import camera_centre
from scenediff_classic.types import VIDEOS, Kind, Video

TABLE = Support("table", (0.0, 1.2), (0.0, 0.8), 0.7, 0.6)
SHELF = Support("shelf", (0.0, 0.8), (0.9, 1.2), 1.3, 0.25)
GREY = Material(np.full((8, 8, 3), 128, np.uint8))


def _wish(size: float, height: float, kind: Kind | None) -> Wish:
    return Wish(Model("box", (Part(box(size, size, height), GREY),)), kind, (TABLE, SHELF))


@pytest.mark.parametrize("seed", range(6))
def test_nothing_overlaps_and_all_is_supported(seed: int) -> None:
    wishes = [_wish(0.12, 0.2, None) for _ in range(4)]
    wishes += [_wish(0.1, 0.3, kind) for kind in ("added", "removed", "moved")]
    items = arrange(np.random.default_rng(seed), wishes, first_id=5)
    assert items is not None
    assert [item.id for item in items] == list(range(5, 12))
    assert len({item.name for item in items}) == 7
    for video in VIDEOS:
        places = [p for item in items if (p := _place(item, video))]
        assert len(places) == 6  # four unchanged, the moved one, and the added or removed one
        _check_apart(places)
    for item in items:
        for place in (item.before, item.after):
            if place:
                _check_inside(place, item, {"table": TABLE, "shelf": SHELF}[place.support])
    moved = next(item for item in items if item.kind == "moved")
    assert moved.before is not None
    assert moved.after is not None
    shift = np.subtract(
        (moved.before.x, moved.before.y, moved.before.z),
        (moved.after.x, moved.after.y, moved.after.z),
    )
    assert np.linalg.norm(shift) >= MOVE_AT_LEAST


def test_tall_things_do_not_go_under_a_low_ceiling() -> None:
    for seed in range(5):
        items = arrange(np.random.default_rng(seed), [_wish(0.1, 0.3, None)], 1)
        assert items is not None
        assert items[0].before is not None
        assert items[0].before.support == "table"


def test_too_much_is_refused() -> None:
    assert arrange(np.random.default_rng(0), [_wish(0.4, 0.2, None) for _ in range(9)], 1) is None


def test_the_same_spec_gives_the_same_scene() -> None:
    spec = _small(split_specs("tiny")[0])
    first, second = compose(spec), compose(spec)
    assert [(i.name, i.kind, i.before, i.after) for i in first.items] == [
        (i.name, i.kind, i.before, i.after) for i in second.items
    ]
    np.testing.assert_array_equal(
        first.before.cameras[0].cam_from_world, second.before.cameras[0].cam_from_world
    )
    assert first.before.sensor == second.before.sensor
    assert {i.kind for i in first.items if i.kind} == {"added", "removed", "moved"}
    assert first.before.lighting != first.after.lighting
    assert first.before.sensor.white_balance != first.after.sensor.white_balance


def test_interpolating_cameras_lie_between_the_others_and_nothing_else_differs() -> None:
    spec = _small(split_specs("tiny")[0])
    far, near = compose(spec), compose(replace(spec, trajectories="interpolating"))
    for item, other in zip(far.items, near.items, strict=True):
        assert (item.before, item.after) == (other.before, other.after)
    assert far.after.sensor == near.after.sensor
    for a, b in zip(far.before.cameras, near.before.cameras, strict=True):
        np.testing.assert_array_equal(a.cam_from_world, b.cam_from_world)
    eyes = np.array([camera_centre(c.cam_from_world) for c in near.before.cameras])
    step = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    for camera, there in zip(near.after.cameras, far.after.cameras, strict=True):
        np.testing.assert_array_equal(camera.intrinsics, there.intrinsics)
        turn = camera.cam_from_world[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        away = np.sort(np.linalg.norm(eyes - camera_centre(camera.cam_from_world), axis=1))
        assert away[:2].sum() < step.max() + 0.06  # on the line between two neighbours, or nearly
        lost = np.linalg.norm(eyes - camera_centre(there.cam_from_world), axis=1)
        assert lost.min() > away[0]


def test_repeated_things_are_alike_and_near_duplicates_almost() -> None:
    base = PairSpec("x", 3, frames=3, width=160, height=120, texture_size=256, close=True)
    for case, alike in (("repeated", True), ("near_duplicate", False)):
        scene = compose(replace(base, hard=(case,)))
        shapes: dict[tuple[str, bytes], list[Item]] = {}
        for item in scene.items:
            mesh = item.model.parts[0].mesh
            shapes.setdefault((item.model.label, mesh.points.tobytes()), []).append(item)
        triple = max(shapes.values(), key=len)
        assert len(triple) == 3
        assert sum(item.kind is not None for item in triple) == 1
        looks = {b"".join(p.material.texture.tobytes() for p in i.model.parts) for i in triple}
        assert len(looks) == (1 if alike else 3)


@pytest.fixture(scope="module")
def room() -> Room:
    return build_room(np.random.default_rng(1), VAL, 128)


@pytest.mark.parametrize("close", [True, False])
@pytest.mark.parametrize("frames", [6, 10, 12])
def test_walks_differ_and_keep_a_stereo_baseline(room: Room, close: bool, frames: int) -> None:
    rng = np.random.default_rng(frames)
    walks = plan_walks(rng, frames, close=close)
    captures = [cameras_along(walk, room, rng, frames, 64, 48) for walk in walks]
    for cameras in captures:
        assert len(cameras) == frames
        eyes = np.array([camera_centre(c.cam_from_world) for c in cameras])
        sight = (eyes - room.table) / np.linalg.norm(eyes - room.table, axis=1, keepdims=True)
        angles = np.degrees(np.arccos((sight[1:] * sight[:-1]).sum(1)))
        assert angles.min() > 5
        assert angles.max() < 14
        assert np.abs(eyes[:, 0]).max() < room.width / 2 - 0.2
        assert eyes[:, 1].min() > 0.2
        assert eyes[:, 1].max() < room.depth
    heights = [captures[k][0].cam_from_world for k in (0, 1)]
    assert abs(camera_centre(heights[0])[2] - camera_centre(heights[1])[2]) > 0.1


def test_splits_share_no_family() -> None:
    for field in (
        "floors",
        "walls",
        "woods",
        "rugs",
        "posters",
        "prints",
        "covers",
        "table_objects",
        "floor_objects",
    ):
        assert not set(getattr(VAL, field)) & set(getattr(TEST, field)), field


def test_splits_have_their_sizes_and_unique_names_and_seeds() -> None:
    sizes = {"demo": 1, "tiny": 2, "val": 12, "test": 24}
    specs = [spec for split in sizes for spec in split_specs(split)]
    for split, size in sizes.items():
        assert len(split_specs(split)) == size
    assert len({spec.name for spec in specs}) == len(specs)
    assert len({spec.seed for spec in specs}) == len(specs)
    assert all(spec.held_out for spec in split_specs("test"))
    assert not any(spec.held_out for spec in split_specs("val"))
    assert sum("no_change" in spec.hard for spec in split_specs("val")) == 2


def test_numbered_pairs_depend_on_the_seed() -> None:
    first, second = numbered_specs(2, 0, 5, 64, 48, ()), numbered_specs(2, 1, 5, 64, 48, ())
    assert not {spec.seed for spec in first} & {spec.seed for spec in second}


@pytest.mark.slow
@pytest.mark.parametrize("split", ["demo", "tiny", "val", "test"])
def test_every_pair_of_a_split_can_be_composed(split: str) -> None:
    for spec in split_specs(split):
        scene = compose(replace(spec, texture_size=256))
        assert ("no_change" in spec.hard) == (not any(item.kind for item in scene.items))
        _check_things(scene)


def _check_things(scene: Scene) -> None:
    ids = [identity for identity, _ in scene.things("before")]
    assert len(set(ids)) == len(ids)
    for video in VIDEOS:
        _check_apart([p for item in scene.items if (p := _place(item, video))])


def _small(spec: PairSpec) -> PairSpec:
    return replace(spec, frames=3, width=160, height=120, texture_size=256)


def _place(item: Item, video: Video) -> Place | None:
    return item.before if video == "before" else item.after


def _check_apart(places: list[Place]) -> None:
    for k, a in enumerate(places):
        for b in places[k + 1 :]:
            if a.support == b.support:
                assert np.hypot(a.x - b.x, a.y - b.y) >= a.radius + b.radius + GAP - 1e-9


def _check_inside(place: Place, item: Item, support: Support) -> None:
    corners = item.standing(place).parts[0].mesh.points.reshape(-1, 3)
    assert corners[:, 2].min() == pytest.approx(support.z, abs=1e-6)
    assert corners[:, 2].max() <= support.z + support.headroom
    assert support.x[0] - 1e-6 <= corners[:, 0].min() <= corners[:, 0].max() <= support.x[1] + 1e-6
    assert support.y[0] - 1e-6 <= corners[:, 1].min() <= corners[:, 1].max() <= support.y[1] + 1e-6
