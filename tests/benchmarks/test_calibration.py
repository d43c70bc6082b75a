"""Fitting the confidence of changes."""

import numpy as np
import pytest

from data_tools.benchmarks.calibration import fit, inputs
from scenediff_classic.change.describe import ConfidenceConfig
from scenediff_classic.types import ChangedObject, ObjectView, Rle, TermScores, Video


def test_fit_finds_the_odds_that_made_the_data() -> None:
    rng = np.random.default_rng(0)
    true = ConfidenceConfig(1, 3, 1.5)
    score, frames = rng.uniform(0, 0.6, 20_000), rng.integers(1, 11, 20_000)
    chance = np.array([true(s, int(n), 10) for s, n in zip(score, frames, strict=True)])
    found = fit(score, frames / 10, rng.uniform(size=len(chance)) < chance)
    assert found.base == pytest.approx(true.base, abs=0.1)
    assert found.per_score == pytest.approx(true.per_score, rel=0.1)
    assert found.per_doubling == pytest.approx(true.per_doubling, rel=0.05)


def test_inputs_are_read_back_from_the_views() -> None:
    config = ConfidenceConfig()

    def view(video: Video, frame: int, frames: int) -> ObjectView:
        return ObjectView(video, frame, config(0.3, frames, 10), (0, 0, 1, 1), Rle((1, 1), "01"))

    views = (*(view("before", k, 4) for k in range(4)), *(view("after", k, 2) for k in range(2)))
    terms = TermScores(0, 0, 0)
    item = ChangedObject(1, "moved", 0.5, None, None, None, None, terms, views)
    score, seen = inputs(item, {"before": 10, "after": 10}, config)
    assert score == pytest.approx(0.3)
    assert seen == pytest.approx(0.3)  # four of ten and two of ten
