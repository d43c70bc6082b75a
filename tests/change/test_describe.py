"""How sure a change is."""

import pytest

from scenediff_classic.change.describe import ConfidenceConfig, looks


def test_confidence_grows_with_the_score_and_with_the_frames() -> None:
    sure = ConfidenceConfig()
    assert sure(0.1, 5, 10) < sure(0.2, 5, 10) < sure(0.4, 5, 10) < 1
    assert 0 < sure(0.2, 1, 10) < sure(0.2, 2, 10) < sure(0.2, 10, 10)


def test_confidence_by_hand() -> None:
    """Log odds -0.5 + 5 x 0.2 + 0.5 x log2(5 / 10) = 0."""
    assert ConfidenceConfig(-0.5, 5, 0.5)(0.2, 5, 10) == pytest.approx(0.5)
    assert ConfidenceConfig(0, 0, 0)(9, 9, 9) == 0.5


def test_looks_lie_between_number_and_share() -> None:
    assert looks(10, 10) == looks(10, 80) == pytest.approx(1)
    assert 3 / 10 < looks(3, 3) < 3 / 3
    assert looks(1, 1) < looks(3, 3) < looks(5, 5) < looks(10, 10)
    assert looks(0, 0) > 0
