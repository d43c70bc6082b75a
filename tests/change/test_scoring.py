"""What a depth difference proves."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.change.scoring import ScoringConfig
from scenediff_classic.types import Regions
from tests.change.running import detect
from tests.plane_scene import VASE, WALL, scene


def _apart(shape: tuple[int, int]) -> Regions:
    """Every pixel a region."""
    count = shape[0] * shape[1]
    return Regions(np.arange(count, dtype=np.int32).reshape(shape), count)


def _one(shape: tuple[int, int]) -> Regions:
    return Regions(np.zeros(shape, np.int32), 1)


def test_evidence_of_depth_golden_values() -> None:
    # by hand: 0.3 * (1 - exp(-(gap / depth / 0.01 - 1) / 6)); the third quartile is below it
    gap = np.array([[*[0.0] * 20, 0.02, 0.14, 2.0, -0.001, np.nan]])
    found = ScoringConfig().depth_evidence(gap, np.full((1, 25), 2.0), _apart((1, 25)))
    expected = [[*[0.0] * 21, 0.3 * (1 - np.exp(-1)), 0.3, -0.001, np.nan]]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_evidence_is_the_same_in_any_unit_and_grows_with_the_difference() -> None:
    gap, depth, regions = np.linspace(0, 1, 200)[None], np.full((1, 200), 1.5), _apart((1, 200))
    found = ScoringConfig().depth_evidence(gap, depth, regions)
    assert np.all(np.diff(found) >= 0)
    again = ScoringConfig().depth_evidence(7 * gap, 7 * depth, regions)
    np.testing.assert_allclose(again, found)


def test_where_all_differs_a_difference_proves_less() -> None:
    # most of the surfaces are 4 percent off, as with wrong poses: so is one at 10 percent
    off, depth, regions = np.full((1, 9), 0.04), np.ones((1, 9)), _apart((1, 9))
    off[0, 0] = 0.1
    exact = np.where(off < 0.1, 0.0, off)
    assert ScoringConfig().depth_evidence(exact, depth, regions)[0, 0] > 0.2
    assert np.all(ScoringConfig().depth_evidence(off, depth, regions) == 0)
    trusting = ScoringConfig(geometry_noise_factor=0.0)
    assert np.all(trusting.depth_evidence(off, depth, regions) > 0.1)


def test_errors_that_average_out_over_a_region_are_no_noise() -> None:
    rough = np.where(np.arange(200) % 2, 0.04, -0.04)[None]
    depth = np.ones((1, 200))
    found = ScoringConfig().depth_evidence(rough, depth, _one((1, 200)))
    smooth = ScoringConfig().depth_evidence(np.abs(rough), depth, _one((1, 200)))
    np.testing.assert_allclose(found[rough > 0], 0.3 * (1 - np.exp(-0.5)))
    assert np.all(smooth == 0)


def test_nothing_known_proves_nothing() -> None:
    unknown = np.full((2, 3), np.nan)
    for regions in (_one((2, 3)), Regions(np.full((2, 3), -1, np.int32), 0)):
        assert np.isnan(ScoringConfig().depth_evidence(unknown, unknown, regions)).all()
        same = ScoringConfig().depth_evidence(np.zeros((2, 3)), np.ones((2, 3)), regions)
        assert np.all(same == 0)


@pytest.mark.parametrize(("distance", "least"), [(0.1, 0.08), (0.3, 0.2)])
def test_a_thing_that_stands_out_by_little_is_seen(distance: float, least: float) -> None:
    # 3.4 and 11 percent of its depth: 0.10 and 0.24 by the formula, where all of it is visible
    thin = replace(VASE, z=WALL.z - distance)
    _, evidence = detect(scene([thin], []), scoring=ScoringConfig(feature_weight=0))
    peak = max(float(np.nanmax(m.geometry)) for m in evidence.scores)
    assert least < peak <= ScoringConfig().geometry_cap
