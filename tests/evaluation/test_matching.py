"""Who takes which truth, worked by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from scenediff_classic.evaluation.matching import (
    DROPPED,
    FALSE,
    HIT,
    ignore_partnered,
    match_best,
    match_free,
)

tables = npst.arrays(
    float,
    st.tuples(st.integers(0, 6), st.integers(0, 5)),
    elements=st.sampled_from([0.0, 0.5, 0.6, 0.7, 1.0]),
)


def test_taken_truth_official_has_no_second_choice():
    iou = np.array([[0.9, 0.0], [0.8, 0.7]])
    assert match_best(iou).tolist() == [HIT, FALSE]
    assert match_free(iou).tolist() == [HIT, HIT]


def test_first_of_equals_wins():
    iou = np.array([[0.8, 0.8], [0.8, 0.0]])
    assert match_best(iou).tolist() == [HIT, FALSE]
    assert match_free(iou).tolist() == [HIT, FALSE]


def test_tolerated_duplicates_are_dropped_until_they_are_too_many():
    iou = np.full((4, 1), 0.9)
    assert match_best(iou, duplicates=3).tolist() == [HIT, DROPPED, DROPPED, FALSE]


def test_false_detections_with_a_right_partner_are_dropped():
    verdicts = np.array([HIT, FALSE, FALSE, FALSE, DROPPED])
    partner = np.array([[0.9, 0.0], [0.0, 0.6], [0.5, 0.5], [0.0, 0.0], [0.0, 0.0]])
    assert ignore_partnered(verdicts, partner).tolist() == [HIT, DROPPED, FALSE, FALSE, DROPPED]
    assert ignore_partnered(verdicts, np.zeros((5, 0))).tolist() == verdicts.tolist()


@pytest.mark.parametrize("match", [match_best, match_free])
@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (3, 0)])
def test_nothing_to_match(match, shape):
    assert match(np.zeros(shape)).tolist() == [FALSE] * shape[0]


@given(tables)
def test_no_truth_is_found_twice(iou):
    for match in (match_best, match_free):
        verdicts = match(iou)
        assert (verdicts == HIT).sum() <= iou.shape[1]
        assert not verdicts[(iou <= 0.5).all(axis=1)].any()


@given(tables)
def test_the_free_choice_never_finds_less(iou):
    assert (match_free(iou) == HIT).sum() >= (match_best(iou) == HIT).sum()


@given(tables)
def test_both_agree_where_detections_do_not_compete(iou):
    best = np.where(iou > 0.5, iou, 0)
    lone = np.zeros_like(best)
    rows = np.arange(min(best.shape))
    lone[rows, rows] = best[rows, rows]
    assert match_best(lone).tolist() == match_free(lone).tolist()
