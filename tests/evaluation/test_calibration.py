"""Reliability of forecasts that are as right as they say, and of ones that boast."""

import numpy as np
import pytest

from scenediff_classic.evaluation.calibration import reliability


def test_an_honest_forecast_has_no_error() -> None:
    rng = np.random.default_rng(0)
    trust = rng.uniform(0, 1, 20_000)
    found = reliability(trust, rng.uniform(size=20_000) < trust)
    assert found.error < 0.02
    assert len(found.rows()) == 10
    np.testing.assert_allclose(found.share, 0.1, atol=0.01)


def test_a_boast_costs_what_it_boasts() -> None:
    """By hand: four findings of 0.95 of which one is right, one of 0.15 that is wrong."""
    found = reliability(np.array([0.95] * 4 + [0.15]), np.array([True] + [False] * 4))
    assert found.error == pytest.approx(0.8 * (0.95 - 0.25) + 0.2 * 0.15)
    assert found.right[9] == 0.25
    assert np.isnan(found.right[5])
    assert len(found.rows()) == 2


def test_certainty_is_in_the_last_bin_and_nothing_gives_nothing() -> None:
    assert reliability(np.ones(3), np.ones(3, bool), bins=5).share[4] == 1
    empty = reliability(np.zeros(0), np.zeros(0, bool))
    assert empty.error == 0
    assert empty.rows() == []
