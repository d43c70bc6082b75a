"""Average precision against a twin that sums over every truth, and its invariants."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenediff_classic.evaluation.average_precision import Ranking, average_precision

confidences = st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0])


@st.composite
def rankings(draw):
    hits = draw(st.lists(st.booleans(), max_size=12))
    confidence = draw(st.lists(confidences, min_size=len(hits), max_size=len(hits)))
    positives = sum(hits) + draw(st.integers(0, 4))
    return Ranking(np.array(confidence, float), np.array(hits, bool), positives)


def brute_force(ranking: Ranking) -> float:
    """Each truth adds the best precision of any cut that finds at least that many truths."""
    if not ranking.positives:
        return 0.0
    order = sorted(range(len(ranking.hit)), key=lambda i: -ranking.confidence[i])
    hits = [bool(ranking.hit[i]) for i in order]
    cuts = [(sum(hits[: n + 1]), sum(hits[: n + 1]) / (n + 1)) for n in range(len(hits))]
    total = 0.0
    for wanted in range(1, ranking.positives + 1):
        total += max((precision for found, precision in cuts if found >= wanted), default=0.0)
    return total / ranking.positives


@given(rankings())
def test_agrees_with_the_twin(ranking):
    assert average_precision(ranking) == pytest.approx(brute_force(ranking), abs=1e-12)


@given(rankings())
def test_lies_between_zero_and_recall(ranking):
    recall = ranking.hit.sum() / ranking.positives if ranking.positives else 0
    assert 0 <= average_precision(ranking) <= recall + 1e-12


@given(rankings(), st.floats(0.1, 10), st.floats(-1, 1))
def test_only_the_order_of_confidences_matters(ranking, scale, shift):
    moved = Ranking(ranking.confidence * scale + shift, ranking.hit, ranking.positives)
    assert average_precision(moved) == average_precision(ranking)


@given(rankings())
def test_a_false_detection_below_all_others_costs_nothing(ranking):
    more = Ranking(
        np.append(ranking.confidence, -1.0), np.append(ranking.hit, False), ranking.positives
    )
    assert average_precision(more) == pytest.approx(average_precision(ranking), abs=1e-12)


@given(rankings())
def test_a_false_detection_above_all_others_never_helps(ranking):
    more = Ranking(
        np.append(2.0, ranking.confidence), np.append(False, ranking.hit), ranking.positives
    )
    assert average_precision(more) <= average_precision(ranking)


def test_perfect_and_empty():
    perfect = Ranking(np.array([0.2, 0.9]), np.array([True, True]), 2)
    assert average_precision(perfect) == 1
    assert average_precision(Ranking(np.zeros(0), np.zeros(0, bool), 3)) == 0


def test_pooling_ranks_over_all_pairs():
    first = Ranking(np.array([0.9, 0.1]), np.array([True, False]), 1)
    second = Ranking(np.array([0.5]), np.array([True]), 2)
    pooled = Ranking.pooled([first, second])
    assert pooled.positives == 3
    assert average_precision(pooled) == pytest.approx(2 / 3)
    assert average_precision(Ranking.pooled([])) == 0


def test_equal_confidences_keep_their_order():
    early = Ranking(np.array([0.5, 0.5]), np.array([True, False]), 1)
    late = Ranking(np.array([0.5, 0.5]), np.array([False, True]), 1)
    assert average_precision(early) == 1
    assert average_precision(late) == 0.5
