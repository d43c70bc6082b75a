"""Which points stand for a region's place."""

import numpy as np

from scenediff_classic.change.changed_regions import ObjectConfig, main_parts

CONFIG = ObjectConfig(merge_radius=0.01)


def patch(x: float, count: int) -> np.ndarray:
    """Points on a small line that hang together."""
    return np.c_[x + np.linspace(0, 0.05, count), np.zeros((count, 2))]


def test_a_bleed_onto_another_thing_is_left_out() -> None:
    thing, bleed = patch(0, 80), patch(0.5, 14)
    np.testing.assert_array_equal(main_parts(np.r_[thing, bleed], CONFIG), thing)


def test_halves_cut_by_something_before_them_are_both_kept() -> None:
    both = np.r_[patch(0, 60), patch(0.5, 40)]
    np.testing.assert_array_equal(main_parts(both, CONFIG), both)


def test_scattered_points_leave_something() -> None:
    scattered = np.arange(30.0)[:, None] * np.ones(3)
    assert len(main_parts(scattered, CONFIG)) > 0
    assert len(main_parts(np.zeros((0, 3)), CONFIG)) == 0


def test_it_can_be_turned_off_and_is_bounded() -> None:
    points = np.r_[patch(0, 80), patch(0.5, 14)]
    assert len(main_parts(points, ObjectConfig(min_part=0))) == 94
    assert len(main_parts(patch(0, 5000), ObjectConfig(max_points=100))) <= 100
