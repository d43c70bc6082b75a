"""What the page picks and computes: key frames, close-ups, score maps, the 3D scene."""

import base64
import json
from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.cameras import camera_centre, unproject
from scenediff_classic.report.comparisons import PANELS, comparison_rows, difference_top, panels
from scenediff_classic.report.crops import best_view, box_corners, crops_of
from scenediff_classic.report.heatmaps import TERMS, scales, score_rows
from scenediff_classic.report.keyframes import choose_pairs, key_pairs
from scenediff_classic.report.palette import heat, heat_gradient
from scenediff_classic.report.viewer import scene_json
from scenediff_classic.types import Comparison, Evidence, Geometry, ScoreMaps, SparsePoints
from tests.report.example import Example, example


@pytest.fixture(scope="module")
def made() -> Example:
    return example()


def captures(made: Example) -> dict:
    return {"before": made.before, "after": made.after}


def flat(value: float) -> ScoreMaps:
    return ScoreMaps(*[np.full((4, 5), value, np.float32)] * 4)


# Key frames


def test_every_object_is_shown_where_a_pair_sees_it(made: Example) -> None:
    chosen = choose_pairs(made.result, made.evidence, 2)
    assert 1 <= len(chosen) <= 2
    keys = [made.evidence.geometry.views[i].key for pair in chosen for i in pair]
    for item in made.result.objects:
        assert any((view.video, view.frame) in keys for view in item.views)


def test_the_best_pair_comes_first_under_a_tight_limit(made: Example) -> None:
    """With one frame where all is large, and others where masks are absent."""
    only = 1
    objects = tuple(
        replace(item, views=tuple(v for v in item.views if v.frame == only))
        for item in made.result.objects
    )
    result = replace(made.result, objects=objects)
    count = len(made.evidence.geometry.views) // 2
    assert choose_pairs(result, made.evidence, 1) == ((only, count + only),)


def test_pairs_are_distinct_ordered_and_bounded(made: Example) -> None:
    for limit in range(6):
        chosen = choose_pairs(made.result, made.evidence, limit)
        assert len(chosen) <= limit
        assert len(set(chosen)) == len(chosen)
        assert list(chosen) == sorted(chosen)
        assert set(chosen) <= set(made.evidence.pairs)


def test_without_change_every_frame_is_shown_once_if_there_is_room() -> None:
    quiet = example(changed=False)
    chosen = choose_pairs(quiet.result, quiet.evidence, 10)
    assert {view for pair in chosen for view in pair} == set(range(6))
    assert len(chosen) == 3


def test_key_frames_name_what_they_show(made: Example) -> None:
    (pair,) = key_pairs(made.result, made.evidence, captures(made), ((1, 4),))
    assert pair.before is not None
    assert pair.after is not None
    assert pair.before.picture.alt == "before, frame 1: 0 removed, 2 moved"
    assert pair.after.picture.alt == "after, frame 1: 1 added, 2 moved"
    assert "1.0 s" in pair.after.title


def test_without_any_pair_the_first_frames_are_shown(made: Example) -> None:
    (pair,) = key_pairs(made.result, made.evidence, captures(made), ())
    assert pair.before is not None
    assert pair.before.title.startswith("frame 0")


# Close-ups


def test_the_best_view_is_large_and_confident(made: Example) -> None:
    item = made.result.objects[2]
    views = [v for v in item.views if v.video == "before"]
    sure = replace(views[1], confidence=1.0)
    assert best_view(replace(item, views=(views[0], sure, views[2])), "before") == sure
    assert best_view(item, "before") in views
    assert best_view(made.result.objects[0], "after") is None


def test_a_removed_object_is_shown_with_its_empty_place(made: Example) -> None:
    crops = crops_of(made.result.objects[0], made.evidence.geometry, captures(made))
    before, after = crops["before"], crops["after"]
    assert before is not None
    assert after is not None
    assert before.shows_object
    assert not after.shows_object
    assert before.image.shape == after.image.shape

    def purple(image: np.ndarray) -> float:
        middle = image[60:116, 60:116].astype(int)
        return float((middle[..., 2] - middle[..., 1]).mean())

    assert purple(before.image) > 25
    assert purple(after.image) < 5


def test_the_place_does_not_depend_on_the_unit_of_the_geometry(made: Example) -> None:
    other = example(unit=2.5)
    for item in made.result.objects:
        ours = crops_of(item, made.evidence.geometry, captures(made))
        theirs = crops_of(item, other.evidence.geometry, captures(other))
        for video in ("before", "after"):
            first, second = ours[video], theirs[video]
            assert first is not None
            assert second is not None
            assert np.abs(first.image.astype(int) - second.image).mean() < 0.5


def test_a_place_out_of_view_has_no_close_up(made: Example) -> None:
    item = replace(made.result.objects[0], centroid_before=(0.0, -40.0, 0.0))
    assert crops_of(item, made.evidence.geometry, captures(made))["after"] is None
    item = replace(made.result.objects[0], centroid_before=None, extent_before=None)
    assert crops_of(item, made.evidence.geometry, captures(made))["after"] is None


def test_box_corners_by_hand() -> None:
    corners = box_corners((1.0, 2.0, 3.0), (2.0, 4.0, 6.0))
    np.testing.assert_allclose(corners[0], [0, 0, 0])
    np.testing.assert_allclose(corners[1], [2, 0, 0])
    np.testing.assert_allclose(corners[6], [0, 4, 6])
    np.testing.assert_allclose(corners[7], [2, 4, 6])


# Score maps


def test_heat_rises_and_marks_the_unknown() -> None:
    ramp = np.linspace(0, 1, 256, dtype=np.float32)[None]
    brightness = heat(ramp, 1.0)[0].astype(int) @ [2, 7, 1]
    assert (np.diff(brightness) >= -10).all()
    assert brightness[-1] - brightness[0] > 2000
    np.testing.assert_array_equal(heat(ramp * 9 + 1, 1.0)[0, 0], heat(ramp, 1.0)[0, -1])
    unknown = heat(np.full((9, 9), np.nan, np.float32), 1.0)
    assert (np.ptp(unknown, axis=2) == 0).all()
    assert len(np.unique(unknown)) == 2


def test_the_gradient_has_the_ends_of_the_colour_map() -> None:
    ends = heat(np.array([[0, 1]], np.float32), 1.0)[0]
    first, last = ("#{:02x}{:02x}{:02x}".format(*colour) for colour in ends)
    assert heat_gradient().startswith(f"linear-gradient(to right, {first}")
    assert heat_gradient().endswith(f"{last})")


def test_scales_are_shared_by_all_views_and_hold_the_threshold() -> None:
    bars = scales((flat(0.2), flat(0.6)), 0.7)
    assert [bar.term for bar in bars] == list(TERMS)
    assert bars[0].top == pytest.approx(0.6)
    assert bars[0].threshold is None
    assert bars[3].top == pytest.approx(0.875)
    assert bars[3].threshold == pytest.approx(0.8)


def test_a_quiet_pair_is_not_blown_up_to_noise() -> None:
    assert all(bar.top == pytest.approx(0.05) for bar in scales((flat(0.001),), None))
    assert all(bar.top == pytest.approx(0.05) for bar in scales((flat(np.nan),), None))
    assert all(bar.top == pytest.approx(0.05) for bar in scales((), None))


def test_score_rows_say_how_high(made: Example) -> None:
    bars = scales(made.evidence.scores, made.result.threshold)
    (row,) = score_rows(made.evidence, (4,), bars, made.result.threshold)
    assert row.title == "after · frame 1"
    assert len(row.maps) == len(TERMS)
    highest = np.nanmax(made.evidence.scores[4].geometry)
    assert row.maps[0].alt == f"geometry score of after · frame 1: highest {highest:.3f}"


# The 3D scene


def unpacked(cloud: dict) -> np.ndarray:
    steps = np.frombuffer(base64.b64decode(cloud["xyz"]), "<u2").reshape(-1, 3) / 65535
    return np.array(cloud["low"]) + steps * np.array(cloud["span"])


def test_points_are_where_the_depth_says(made: Example) -> None:
    scene = json.loads(scene_json(made.result, made.evidence.geometry))
    views = made.evidence.geometry.of("before")
    true = np.concatenate([unproject(v)[v.measured] for v in views])
    points = unpacked(scene["clouds"]["before"])
    assert len(points) == scene["clouds"]["before"]["count"] == len(true)
    # The page's frame is the world's, shifted and scaled: undo it by the cameras.
    shown = np.array([camera["shape"][0] for camera in scene["cameras"]])
    world = np.array([camera_centre(v.cam_from_world) for v in made.evidence.geometry.views])
    scale = np.ptp(world, axis=0).max() / np.ptp(shown, axis=0).max()
    back = (points - shown.mean(0)) * scale + world.mean(0)
    np.testing.assert_allclose(back.mean(0), true.mean(0), atol=2e-3)
    np.testing.assert_allclose(back.min(0), true.min(0), atol=5e-3)
    np.testing.assert_allclose(back.max(0), true.max(0), atol=5e-3)


def test_the_scene_looks_the_same_in_every_unit(made: Example) -> None:
    first = json.loads(scene_json(made.result, made.evidence.geometry))
    second = json.loads(scene_json(made.result, example(unit=10.0).evidence.geometry))
    for ours, theirs in zip(first["objects"], second["objects"], strict=True):
        assert ours["boxes"].keys() == theirs["boxes"].keys()
        for video in ours["boxes"]:
            np.testing.assert_allclose(ours["boxes"][video], theirs["boxes"][video], atol=2e-3)
    np.testing.assert_allclose(first["from"], second["from"], atol=2e-3)
    sizes = [
        np.frombuffer(base64.b64decode(s["clouds"]["after"]["size"]), np.uint8).astype(int)
        for s in (first, second)
    ]
    assert sizes[0].min() > 0
    assert np.abs(sizes[0] - sizes[1]).max() <= 1


def test_boxes_enclose_the_tinted_points(made: Example) -> None:
    scene = json.loads(scene_json(made.result, made.evidence.geometry))
    plain = json.loads(scene_json(replace(made.result, objects=()), made.evidence.geometry))
    for video in ("before", "after"):
        points = unpacked(scene["clouds"][video])
        colours = [
            np.frombuffer(base64.b64decode(s["clouds"][video]["rgb"]), np.uint8).reshape(-1, 3)
            for s in (scene, plain)
        ]
        tinted = (colours[0] != colours[1]).any(axis=1)
        inside = np.zeros_like(tinted)
        for item in scene["objects"]:
            if video in item["boxes"]:
                box = np.array(item["boxes"][video])
                inside |= np.all((points > box.min(0)) & (points < box.max(0)), axis=1)
        assert tinted.sum() > 100
        # Points lie on the faces of the boxes: allow for the rounding to 16 bits.
        near = np.zeros_like(tinted)
        for item in scene["objects"]:
            if video in item["boxes"]:
                box = np.array(item["boxes"][video])
                near |= np.all((points > box.min(0) - 1e-3) & (points < box.max(0) + 1e-3), axis=1)
        assert near[tinted].all()
        assert tinted[inside].all()


def test_up_points_up(made: Example) -> None:
    scene = json.loads(scene_json(made.result, made.evidence.geometry))
    assert np.dot(scene["up"], [0, 0, 1]) > 0.7


def test_the_json_cannot_end_its_script_element(made: Example) -> None:
    views = tuple(replace(v, name="</script><b>") for v in made.evidence.geometry.views)
    text = scene_json(made.result, replace(made.evidence.geometry, views=views))
    assert "<" not in text
    assert json.loads(text)["cameras"][0]["name"] == "</script><b>"


def test_without_depth_the_sparse_points_are_shown(made: Example) -> None:
    views = tuple(
        replace(v, depth=np.full_like(v.depth, np.nan), measured=np.zeros_like(v.measured))
        for v in made.evidence.geometry.views
    )
    points = SparsePoints(
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]),
        np.full((3, 3), 9, np.uint8),
        np.array([[0, 0], [1, 4], [2, 1], [2, 5]]),
    )
    geometry = replace(made.evidence.geometry, views=views, points=points)
    scene = json.loads(scene_json(made.result, geometry))
    assert scene["clouds"]["before"]["count"] == 2
    assert scene["clouds"]["after"]["count"] == 2


def test_no_view_at_all(made: Example) -> None:
    nothing = Geometry((), SparsePoints.none())
    scene = json.loads(scene_json(made.result, nothing))
    assert scene["cameras"] == []
    assert choose_pairs(made.result, Evidence(nothing, (), ()), 4) == ()


def test_only_videos_have_trails(made: Example) -> None:
    photos = tuple(replace(f, time_s=None) for f in made.result.after.frames)
    result = replace(made.result, after=replace(made.result.after, frames=photos))
    trails = json.loads(scene_json(result, made.evidence.geometry))["trails"]
    assert trails == {"before": True, "after": False}


# Captured and rendered


def test_compared_views_have_all_panels_and_others_none(made: Example) -> None:
    view = made.evidence.geometry.views[1]
    difference = np.full(view.shape, 0.2, np.float32)
    difference[:5] = np.nan
    found = np.zeros(view.shape, bool)
    found[10:20, 10:20] = True
    one = Comparison(1, view.image, 255 - view.image, difference, found)
    evidence = replace(made.evidence, comparisons=(one,))
    (row,) = comparison_rows(evidence, (0, 1, 2))
    assert row.title == f"{view.video} · frame {view.index}"
    assert [p.alt.split(", ")[-1] for p in row.panels] == list(PANELS)
    assert len({(p.width, p.height) for p in row.panels}) == 1
    assert difference_top([one]) == pytest.approx(0.2, abs=1e-6)
    assert difference_top([]) == pytest.approx(0.05)  # nothing to show is not blown up
    captured, rendered, heat_map, outlined = panels(one, 0.2)
    assert captured is view.image
    assert rendered[0, 0, 0] == 255 - view.image[0, 0, 0]
    assert len(np.unique(heat_map[8:].reshape(-1, 3), axis=0)) == 1  # one difference, one colour
    changed = (outlined != view.image).any(axis=-1)
    assert changed[10:20, 10:20].any()
    assert not changed[30:].any()
    assert comparison_rows(made.evidence, (0, 1, 2)) == ()
