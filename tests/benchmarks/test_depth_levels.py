"""Depth from few levels: exact where planes allow it, and never outside its level."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from data_tools.benchmarks.depth_levels import between_levels


def test_stairs_become_a_slope_again() -> None:
    rows, columns = np.mgrid[:60, :80]
    slope = 20 + rows / 8 + columns / 30
    error = np.abs(between_levels(slope.astype(np.uint8)) - slope)
    stairs = np.abs(slope.astype(np.uint8) + 0.5 - slope)
    inside = (slice(10, -10), slice(10, -10))  # at the picture's edge nothing tells where to go
    assert error[inside].mean() < 0.2 * stairs[inside].mean()


def test_surfaces_at_different_depths_stay_apart() -> None:
    levels = np.full((20, 20), 30, np.uint8)
    levels[:, 10:] = 40
    levels[:3] = 0
    smooth = between_levels(levels)
    assert np.isnan(smooth[:3]).all()
    np.testing.assert_array_equal(smooth[3:, :10], 30.5)
    np.testing.assert_array_equal(smooth[3:, 10:], 40.5)


@settings(max_examples=30, deadline=None)
@given(arrays.arrays(np.uint8, (7, 9), elements=st.integers(0, 6)))
def test_depth_never_leaves_its_level(levels: np.ndarray) -> None:
    smooth = between_levels(levels)
    assert np.array_equal(np.isnan(smooth), levels == 0)
    known = levels > 0
    assert (smooth[known] >= levels[known]).all()
    assert (smooth[known] <= levels[known] + 1).all()
