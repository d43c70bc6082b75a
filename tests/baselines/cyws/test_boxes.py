"""Overlap, suppression, pairs of boxes, average precision."""

import numpy as np
import pytest

from baselines.cyws.average_precision import average_precision, hits
from baselines.cyws.boxes import Boxes, filtered, iou, pair_boxes, suppress
from baselines.cyws.registration import affine_2d


def _boxes(*rows: tuple[float, ...]) -> Boxes:
    table = np.array(rows, np.float32).reshape(-1, 5)
    return Boxes(table[:, :4], table[:, 4])


def test_overlap() -> None:
    a = np.array([[0, 0, 2, 2], [5, 5, 6, 6]], float)
    np.testing.assert_allclose(iou(a, np.array([[1, 0, 3, 2]], float)), [[1 / 3], [0]])


def test_suppression_keeps_the_best() -> None:
    found = suppress(_boxes((1, 0, 11, 10, 0.5), (0, 0, 10, 10, 0.9), (30, 0, 40, 10, 0.2)))
    np.testing.assert_allclose(found.score, [0.9, 0.2])
    small = filtered(_boxes((0, 0, 10, 10, 0.9), (0, 0, 40, 40, 0.5)), 224, 224)
    np.testing.assert_allclose(small.score, [0.5])


def test_each_box_is_in_one_pair() -> None:
    flat = affine_2d(np.array([[[1, 0, 0.1], [0, 1, 0]]]), 100, 100)
    first = _boxes((10, 10, 30, 30, 0.9), (12, 12, 26, 26, 0.3), (60, 60, 70, 70, 0.05))
    second = _boxes((20, 10, 40, 30, 0.6), (70, 0, 90, 9, 0.4))
    pairs = pair_boxes(first, second, (100, 100), (100, 100), flat)
    assert [(p.first and p.first[0], p.second and p.second[0]) for p in pairs] == [
        (10.0, 20.0), (None, 70.0), (12.0, None),
    ]  # fmt: skip
    np.testing.assert_allclose([p.score for p in pairs], [0.9, 0.4, 0.3])


@pytest.mark.parametrize("first", [0, 1])
def test_no_boxes_no_pairs(first: int) -> None:
    some = [_boxes((0, 0, 9, 9, 0.5)), _boxes()]
    pairs = pair_boxes(some[first], some[1 - first], (10, 10), (20, 20), None)
    assert len(pairs) == 1
    assert (pairs[0].second is None) == (first == 0)
    assert pair_boxes(_boxes(), _boxes(), (10, 10), (10, 10), None) == []


def test_the_second_box_on_a_truth_is_wrong() -> None:
    truth = np.array([[0, 0, 10, 10], [20, 0, 30, 10]], float)
    found = _boxes((0, 0, 10, 9, 0.3), (0, 0, 10, 10, 0.8), (20, 0, 29, 10, 0.5), (4, 0, 14, 10, 1))
    assert hits(found, truth).tolist() == [False, True, True, False]
    assert not hits(found, np.zeros((0, 4))).any()


def test_average_precision_by_hand() -> None:
    score = [np.array([0.9, 0.6]), np.array([0.8, 0.5])]
    right = [np.array([True, False]), np.array([False, True])]
    # right, wrong, wrong, right of 2: precision 1 up to recall 1/2, then 2/4
    assert average_precision(score, right, 2) == pytest.approx(0.75)
    assert average_precision(score[::-1], right[::-1], 2) == pytest.approx(0.75)
    assert average_precision(score, right, 4) == pytest.approx(0.375)
    assert np.isnan(average_precision([], [], 0))
    assert average_precision([], [], 3) == 0


def test_equal_scores_are_one_point() -> None:
    score, right = [np.array([0.5]), np.array([0.5])], [np.array([True]), np.array([False])]
    assert average_precision(score, right, 1) == average_precision(score, right[::-1], 1) == 0.5
