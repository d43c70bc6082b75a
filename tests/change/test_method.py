"""The whole method on the analytic card scene: what changed, and what must not matter."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.change.scale import normalised, rescaled
from scenediff_classic.change.scoring import ScoringConfig, reweighted, score_changes
from scenediff_classic.errors import AlignmentError
from scenediff_classic.masks import decode
from scenediff_classic.pipeline import DetectConfig
from scenediff_classic.types import SparsePoints
from tests.change.running import detect, masks_of, summary
from tests.plane_scene import BOOK, BOOK_ELSEWHERE, CLOCK, VASE, render, scene


@pytest.fixture(scope="module")
def changed():
    """Vase removed, clock added, book moved."""
    return scene([VASE, BOOK], [BOOK_ELSEWHERE, CLOCK])


@pytest.fixture(scope="module")
def found(changed):
    return detect(changed)[0]


def strong(result, least: float = 0.3):
    return [o for o in result.objects if o.confidence > least]


def test_finds_what_was_added_removed_and_moved(found):
    kinds = sorted((o.kind, len(o.views)) for o in strong(found))
    assert kinds == [("added", 3), ("moved", 6), ("removed", 3)]


def test_masks_cover_the_changed_cards(changed, found):
    depth_of = {"before": [VASE.z, BOOK.z], "after": [BOOK_ELSEWHERE.z, CLOCK.z]}
    union = masks_of(found)
    for view in changed.views:
        plane = view.depth + view.cam_from_world[2, 3] * -1
        truth = np.any([np.abs(plane - z) < 1e-3 for z in depth_of[view.video]], axis=0)
        mask = union[view.key]
        iou = (mask & truth).sum() / (mask | truth).sum()
        assert iou > 0.8, view.key


def test_positions_are_in_the_world_of_the_geometry(found):
    removed = next(o for o in strong(found) if o.kind == "removed")
    expected = VASE.x + VASE.width / 2, VASE.y + VASE.height / 2, VASE.z
    assert removed.centroid_before == pytest.approx(expected, abs=0.03)
    assert removed.centroid_after is None
    assert removed.extent_before == pytest.approx(
        (0.9 * VASE.width, 0.9 * VASE.height, 0), abs=0.03
    )
    moved = next(o for o in strong(found) if o.kind == "moved")
    travelled = np.subtract(moved.centroid_after, moved.centroid_before)
    assert travelled == pytest.approx(
        [BOOK_ELSEWHERE.x - BOOK.x, BOOK_ELSEWHERE.y - BOOK.y, 0], abs=0.05
    )


def test_identical_captures_give_no_changes():
    result, _ = detect(scene([VASE, BOOK], [VASE, BOOK]))
    assert result.objects == ()
    assert result.threshold is None


def test_world_scale_changes_nothing(changed, found):
    big = rescaled(changed, 0.1)
    result, _ = detect(replace(big, unit=1.0))
    assert summary(result) == summary(found)
    assert result.scale == pytest.approx(10 * found.scale, rel=1e-4)
    for key, mask in masks_of(found).items():
        assert np.array_equal(mask, masks_of(result)[key])


def test_swapping_the_captures_swaps_added_and_removed(found):
    other = detect(scene([BOOK_ELSEWHERE, CLOCK], [VASE, BOOK]))[0]
    kinds = sorted(o.kind for o in strong(other))
    assert kinds == sorted(o.kind for o in strong(found))  # one of each kind
    # the two trajectories stay, so pictures differ; places must agree
    removed = next(o for o in strong(other) if o.kind == "removed")
    added = next(o for o in strong(found) if o.kind == "added")
    assert removed.centroid_before == pytest.approx(added.centroid_after, abs=0.05)


def test_relabelling_the_captures_mirrors_the_result_exactly(changed, found):
    other = {"before": "after", "after": "before"}
    views = tuple(replace(v, video=other[v.video]) for v in changed.views)
    result, _ = detect(replace(changed, views=views[3:] + views[:3]))
    mirrored = {"added": "removed", "removed": "added", "moved": "moved"}
    assert summary(result) == sorted((mirrored[o.kind], len(o.views)) for o in found.objects)
    masks = masks_of(result)
    for (video, index), mask in masks_of(found).items():
        assert np.array_equal(mask, masks[other[video], index])


def test_order_of_frames_does_not_matter(changed, found):
    order = [2, 0, 1, 5, 4, 3]
    result, _ = detect(replace(changed, views=tuple(changed.views[k] for k in order)))
    assert summary(result) == summary(found)
    masks = masks_of(result)
    for key, mask in masks_of(found).items():
        assert np.array_equal(mask, masks[key])


def test_two_single_pictures(changed):
    views = (changed.views[1], changed.views[4])
    result, _ = detect(replace(changed, views=views))
    kinds = sorted(o.kind for o in strong(result))
    assert kinds == ["added", "moved", "removed"]
    for item in result.objects:
        per_video = [v.video for v in item.views]
        assert len(per_video) == len(set(per_video))


def test_dynamic_content_is_ignored(changed):
    def hide(view):
        plane = view.depth - view.cam_from_world[2, 3]
        return replace(view, ignore=np.abs(plane - VASE.z) < 1e-3)

    views = tuple(hide(v) if v.video == "before" else v for v in changed.views)
    result, _ = detect(replace(changed, views=views))
    assert sorted(o.kind for o in strong(result)) == ["added", "moved"]


def test_occluded_is_not_removed():
    # a screen stands before the vase in the after capture: the vase cannot be said to be gone
    screen = replace(VASE, x=VASE.x - 0.3, y=VASE.y - 0.3, z=1.6, width=0.9, height=0.9, seed=40)
    result, _ = detect(scene([VASE], [VASE, screen]))
    assert [o.kind for o in strong(result)] == ["added"]
    centroid = strong(result)[0].centroid_after
    assert centroid[2] == pytest.approx(screen.z, abs=0.02)


def test_guessed_depth_is_no_evidence(changed):
    guessed = tuple(replace(v, measured=v.measured & (v.video == "before")) for v in changed.views)
    _, evidence = detect(replace(changed, views=guessed))
    for maps in evidence.scores:
        assert np.nanmax(np.abs(maps.geometry)) == 0


def test_a_measured_half_can_stand_for_the_whole(changed):
    def halved(view):
        stripes = np.arange(view.shape[1]) // 4 % 2 == 0
        return replace(view, measured=view.measured & stripes)

    views = tuple(halved(v) for v in changed.views)
    strict, lenient, full = (
        detect(geometry, scoring=ScoringConfig(measured_share=share))[1]
        for geometry, share in (
            (replace(changed, views=views), 1.0),
            (replace(changed, views=views), 0.2),
            (changed, 1.0),
        )
    )
    peaks = [max(np.nanmax(m.geometry) for m in e.scores) for e in (strict, lenient, full)]
    assert peaks[0] < 0.7 * peaks[2]
    assert peaks[1] == pytest.approx(peaks[2], rel=0.2)


def test_no_depth_at_all_is_one_clear_sentence(changed):
    blind = tuple(replace(v, measured=np.zeros(v.shape, bool)) for v in changed.views)
    with pytest.raises(AlignmentError, match="No depth could be measured"):
        detect(replace(changed, views=blind))


def test_masks_have_the_input_size():
    from scenediff_classic.types import Geometry, Lens

    geometry = scene([VASE], [])
    views = []
    for view in geometry.views:
        intrinsics = np.diag([2.0, 2.0, 1.0]) @ view.intrinsics
        views.append(replace(view, lens=Lens(240, 180, intrinsics, np.zeros(4))))
    result, _ = detect(Geometry(tuple(views), SparsePoints.none()))
    assert result.objects
    assert decode(result.objects[0].views[0].mask).shape == (180, 240)
    assert render([], "before", 0, (0, 0, 0)).shape == (90, 120)


def test_every_object_says_what_speaks_for_it(changed, found):
    for item in strong(found):
        assert item.support is not None
        assert 0 < item.support.above <= item.support.compared
        assert item.support.compared <= 9 * (2 if item.kind == "moved" else 1)  # 3 x 3 frames
        scores = [pair.score for pair in item.support.strongest]
        assert scores == sorted(scores, reverse=True)
        assert scores[0] > found.threshold
        shown = {(v.video, v.frame) for v in item.views}
        assert {(p.video, p.frame) for p in item.support.strongest} <= shown
    moved = next(o for o in strong(found) if o.kind == "moved")
    assert moved.match is not None
    assert moved.match.similarity > moved.match.least
    assert moved.match.size_ratio == pytest.approx(1, abs=0.2)


def test_other_weights_need_no_new_comparison(changed):
    geometry = normalised(changed)
    regions = [DetectConfig().regions(view) for view in geometry.views]
    features, usual = DetectConfig().features, ScoringConfig()
    other = ScoringConfig(geometry_weight=0.3, feature_weight=0.9, region_weight=0.4, voxel=0.02)
    quick = reweighted(score_changes(geometry, regions, features, usual), geometry, regions, other)
    full = score_changes(geometry, regions, features, other)
    for a, b in zip(quick.maps, full.maps, strict=True):
        assert np.array_equal(a.total, b.total, equal_nan=True)
    for a, b in zip(quick.regions, full.regions, strict=True):
        assert np.array_equal(a.total, b.total, equal_nan=True)
