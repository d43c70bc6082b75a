"""Kapur's threshold against a direct transcription, and its no-change outcome."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenediff_classic.change.threshold import (
    NOISE_FLOOR,
    ThresholdConfig,
    change_threshold,
    maximum_entropy_threshold,
)
from scenediff_classic.types import ScoreMaps


def entropy_threshold_by_definition(values: np.ndarray, bins: int) -> float:
    """The paper's sums, one cut at a time."""
    low, high = values.min(), values.max()
    counts = np.histogram(values, bins, (low, high))[0]
    p = counts / counts.sum()
    best, cut = -np.inf, 0
    for t in range(bins - 1):
        first, second = p[: t + 1], p[t + 1 :]
        if first.sum() <= 1e-12 or second.sum() <= 1e-12:
            continue
        total = 0.0
        for part in (first, second):
            q = part[part > 0] / part.sum()
            total -= (q * np.log(q)).sum()
        if total > best + 1e-9:
            best, cut = total, t
    return low + cut * (high - low) / bins


@given(st.integers(0, 10_000), st.integers(3, 40))
def test_agrees_with_the_definition(seed, bins):
    rng = np.random.default_rng(seed)
    values = np.concatenate([rng.normal(0, 1, 200), rng.normal(rng.uniform(2, 8), 0.5, 30)])
    expected = entropy_threshold_by_definition(values, bins)
    assert maximum_entropy_threshold(values, bins) == pytest.approx(expected, abs=1e-9)


def test_separates_two_clear_groups():
    rng = np.random.default_rng(0)
    values = np.concatenate([rng.uniform(0.0, 0.1, 5000), rng.uniform(0.5, 0.9, 400)])
    assert 0.05 < maximum_entropy_threshold(values) < 0.5


def maps_of(total: np.ndarray) -> ScoreMaps:
    blank = np.full_like(total, np.nan)
    return ScoreMaps(blank, blank, blank, total)


@pytest.mark.parametrize(
    "total",
    [
        np.zeros((40, 40), np.float32),
        np.full((40, 40), np.nan, np.float32),
        np.random.default_rng(0).uniform(0, 0.05, (40, 40)).astype(np.float32),
    ],
    ids=["all zero", "nothing visible", "pure noise"],
)
def test_noise_never_passes_the_floor(total):
    assert change_threshold([maps_of(total)], ThresholdConfig()) == NOISE_FLOOR
    assert change_threshold([maps_of(total)], ThresholdConfig(noise_floor=0.2)) == 0.2


def test_fixed_threshold_wins():
    assert (
        change_threshold([maps_of(np.ones((4, 4), np.float32))], ThresholdConfig(fixed=0.4)) == 0.4
    )
