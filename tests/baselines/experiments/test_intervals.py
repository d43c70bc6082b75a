"""Bootstrap intervals over pairs."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.experiments.intervals import bootstrap, drawn, paired_difference
from data_tools.benchmarks.benchmark import BenchmarkPair


class Mean:
    """A benchmark whose only figure is the mean of numbers; None where all are unknown."""

    name = "mean"
    metrics: Mapping[str, str] = {"mean": "mean"}

    def pairs(self) -> tuple[BenchmarkPair, ...]:
        return ()

    def problems(self) -> tuple[str, ...]:
        return ()

    def judge(self, pair: BenchmarkPair, run: Path | None) -> float | None:
        return None

    def pool(self, judged: Sequence[float | None]) -> dict[str, float | None]:
        known = [value for value in judged if value is not None]
        return {"mean": float(np.mean(known)) if known else None}


shares = st.lists(st.floats(0, 1), min_size=2, max_size=12)


@given(shares)
@settings(max_examples=25, deadline=None)
def test_an_interval_lies_within_the_data_and_around_the_median_draw(values: list[float]) -> None:
    low, high = bootstrap(Mean(), values, draws=60)["mean"]
    assert min(values) - 1e-12 <= low <= high <= max(values) + 1e-12


@given(st.floats(0, 1), st.integers(2, 12))
@settings(max_examples=25, deadline=None)
def test_equal_pairs_leave_no_doubt(value: float, count: int) -> None:
    low, high = bootstrap(Mean(), [value] * count, draws=40)["mean"]
    assert low == pytest.approx(value)
    assert high == pytest.approx(value)


def test_the_seed_decides_the_draws() -> None:
    values = [0.1, 0.9, 0.4, 0.3]
    assert bootstrap(Mean(), values, seed=3) == bootstrap(Mean(), values, seed=3)
    assert bootstrap(Mean(), values, seed=3) != bootstrap(Mean(), values, seed=4)
    np.testing.assert_array_equal(drawn(5, 7, 1), drawn(5, 7, 1))


def test_the_interval_of_a_mean_is_the_one_of_theory() -> None:
    """For many pairs the bootstrap's half width is 1.96 standard errors of the mean."""
    values = list(np.random.default_rng(0).normal(0.5, 0.1, 200))
    low, high = bootstrap(Mean(), values, draws=4000)["mean"]
    assert (high - low) / 2 == pytest.approx(1.96 * 0.1 / np.sqrt(200), rel=0.12)


def test_one_pair_has_no_interval_and_an_undefined_figure_neither() -> None:
    assert bootstrap(Mean(), [0.5]) == {}
    assert bootstrap(Mean(), [None, None, None], draws=20) == {}
    assert paired_difference(Mean(), [0.5], [0.7])["mean"].interval is None


def test_a_difference_is_paired() -> None:
    """A steady gain on pairs that vary a lot is clear; two single intervals would overlap."""
    first = [0.1, 0.9, 0.4, 0.3, 0.6]
    found = paired_difference(Mean(), first, [value + 0.05 for value in first])["mean"]
    assert found.difference == pytest.approx(0.05)
    assert found.interval == pytest.approx((0.05, 0.05))
    assert found.clear
    assert found.better == (0, 1, 2, 3, 4)
    assert found.worse == ()


def test_a_difference_names_the_pairs_that_fell() -> None:
    found = paired_difference(Mean(), [0.2, 0.5, None, 0.4], [0.1, 0.5, 0.3, 0.9])["mean"]
    assert (found.better, found.worse) == ((3,), (0,))
    assert not found.clear


def test_runs_over_different_pairs_are_not_compared() -> None:
    with pytest.raises(ValueError, match="2 judged pairs"):
        paired_difference(Mean(), [0.1, 0.2], [0.3])
