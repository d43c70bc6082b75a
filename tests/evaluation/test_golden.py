"""The cases that were observed on the published evaluator, and what strict mode says to them.

Provenance: outputs of the SceneDiff Benchmark's own evaluation script on these inputs.
"""

import numpy as np
import pytest

from scenediff_classic.evaluation import Metrics, average_precision, rules_of, score_pair
from scenediff_classic.evaluation.average_precision import precision_recall_area
from scenediff_classic.evaluation.pairs import summarise
from tests.evaluation.scenes import box, prediction, truth

A, B = box(0, 0, 100, 100), box(500, 500, 100, 100)
BOTH_MODES = pytest.mark.parametrize("mode", ["official", "strict"])


def measure(true, reported, mode, **options) -> Metrics:
    rules = rules_of(mode, **options)
    return summarise([score_pair(true, reported, rules)], rules)


@BOTH_MODES
def test_moved_object_predicted_as_removed_and_added(mode):
    true = truth({"before": {0: A}, "after": {0: B}})
    reported = prediction((0.9, {"before": {0: A}}), (0.8, {"after": {0: B}}))
    metrics = measure(true, reported, mode)
    assert metrics.obj_im_ap == 1
    assert metrics.obj_sc_ap == 0  # each half has an IoU of exactly one half
    assert metrics.found_objects == 0
    assert metrics.px_im_iou == 1
    scores = score_pair(true, reported, rules_of(mode))
    assert scores.objects.hit.tolist() == [False, False]


@BOTH_MODES
def test_iou_of_exactly_one_half_is_a_false_positive(mode):
    half = truth({"before": {0: box(0, 0, 100, 100)}})
    exact = measure(half, prediction((1.0, {"before": {0: box(0, 0, 100, 50)}})), mode)
    more = measure(half, prediction((1.0, {"before": {0: box(0, 0, 100, 51)}})), mode)
    assert (exact.obj_im_ap, exact.obj_sc_ap, exact.px_im_iou) == (0, 0, 0.5)
    assert (more.obj_im_ap, more.obj_sc_ap) == (1, 1)


@BOTH_MODES
def test_object_without_a_sampled_frame_counts_in_the_scene_only(mode):
    true = truth({"before": {0: A}}, {"before": {}})
    metrics = measure(true, prediction((1.0, {"before": {0: A}})), mode)
    assert metrics.obj_sc_ap == 0.5
    assert metrics.obj_im_ap == 1


@BOTH_MODES
def test_mask_lost_in_the_resize_still_counts(mode):
    size = (2048, 2048)
    large = box(0, 0, 200, 200, size)
    speck = box(1001, 1001, 1, 1, size)  # odd position: halving the size skips it
    true = truth({"before": {0: large}}, {"before": {0: speck}})
    metrics = measure(true, prediction((1.0, {"before": {0: large}})), mode)
    assert metrics.obj_im_ap == 0.5
    assert metrics.obj_sc_ap == 0.5
    assert metrics.px_im_iou == 1


@BOTH_MODES
def test_predicted_moved_where_truth_was_removed(mode):
    true = truth({"before": {0: A}})
    reported = prediction((1.0, {"before": {0: A}, "after": {}}))
    metrics = measure(true, reported, mode)
    assert metrics.obj_sc_ap == 1
    assert metrics.obj_sc_ap_typed == 0


def test_which_change_types_agree():
    kinds = ("added", "removed", "moved")
    official, strict = rules_of("official").same_type, rules_of("strict").same_type
    assert [[strict(p, t) for t in kinds] for p in kinds] == np.eye(3, dtype=bool).tolist()
    assert [[official(p, t) for t in kinds] for p in kinds] == [
        [True, True, False],
        [True, True, False],
        [False, False, True],
    ]


@pytest.mark.parametrize(("tolerance", "judged"), [(1, [True, False]), (2, [True])])
def test_duplicate_detection(tolerance, judged):
    true = truth({"before": {0: A}})
    twice = prediction((0.9, {"before": {0: A}}), (0.8, {"before": {0: A}}))
    rules = rules_of("official", region_duplicates=tolerance, object_duplicates=tolerance)
    scores = score_pair(true, twice, rules)
    assert scores.regions.hit.tolist() == judged
    assert scores.objects.hit.tolist() == judged
    assert scores.typed_objects.hit.tolist() == judged


def test_third_duplicate_is_false_even_when_two_are_tolerated():
    true = truth({"before": {0: A}})
    thrice = prediction(*((c, {"before": {0: A}}) for c in (0.9, 0.8, 0.7)))
    scores = score_pair(true, thrice, rules_of("official", 2, 2))
    assert scores.objects.hit.tolist() == [True, False]
    assert scores.objects.confidence.tolist() == [0.9, 0.7]


def test_average_precision_of_a_known_curve():
    recall = np.array([0.25, 0.25, 0.5, 0.5, 0.75])
    precision = np.array([1, 0.5, 2 / 3, 0.5, 0.6])
    assert precision_recall_area(recall, precision) == pytest.approx(0.566667, abs=1e-6)


def test_average_precision_of_the_same_curve_from_detections():
    true = truth(*({"before": {k: A}} for k in range(4)))
    hits = [{"before": {0: A}}, {"before": {9: A}}, {"before": {1: A}}, {"after": {2: A}}]
    reported = prediction(*zip((0.9, 0.8, 0.7, 0.6, 0.5), [*hits, {"before": {2: A}}], strict=True))
    scores = score_pair(true, reported, rules_of("strict"))
    assert average_precision(scores.regions) == pytest.approx(0.566667, abs=1e-6)
    assert average_precision(scores.objects) == pytest.approx(0.566667, abs=1e-6)
