"""The size at which masks are compared, in both modes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenediff_classic.dataset import AnnotatedMask, AnnotatedPair, Prediction, Track
from scenediff_classic.evaluation.official import official_grid, scaled_to_long_side
from scenediff_classic.evaluation.strict import strict_grid
from tests.evaluation.scenes import box, prediction, truth

NOTHING = Prediction(())


def of_size(height: int, width: int):
    return box(0, 0, 1, 1, (height, width))


def tracks(*sizes_of_objects: tuple[str, list[tuple[int, int]]]) -> AnnotatedPair:
    """Tracks with one mask per given size, from frame 0."""
    made = (
        Track(video, i, tuple(AnnotatedMask(30 * k, of_size(*s)) for k, s in enumerate(sizes)))
        for i, (video, sizes) in enumerate(sizes_of_objects)
    )
    return AnnotatedPair("", tuple(made), ())


def test_official_exchanges_the_sides():
    portrait = tracks(("before", [(1920, 1080)]))
    assert official_grid(portrait, NOTHING)("before", 0) == (576, 1024)
    assert strict_grid(portrait, NOTHING)("before", 0) == (1024, 576)


def test_official_takes_one_grid_for_the_pair_and_strict_one_a_frame():
    pair = tracks(("before", [(480, 640), (640, 480)]), ("after", [(960, 1280)]))
    official, strict = official_grid(pair, NOTHING), strict_grid(pair, NOTHING)
    assert {official(v, k) for v in ("before", "after") for k in (0, 1)} == {(1024, 768)}
    assert strict("before", 0) == (768, 1024)
    assert strict("before", 1) == (1024, 768)
    assert strict("after", 0) == (768, 1024)


@pytest.mark.parametrize(
    ("pair", "sides"),
    [
        # The first object with a mask counts, and of it the first frame.
        ((("before", []), ("before", [(10, 20), (90, 90)]), ("before", [(99, 99)])), (1024, 512)),
        # The larger of the two captures wins.
        ((("before", [(10, 20)]), ("after", [(20, 20)])), (1024, 1024)),
        ((("before", [(20, 20)]), ("after", [(10, 20)])), (1024, 1024)),
        # Once the before capture gave a size, only the after capture's first object is asked.
        ((("before", [(10, 20)]), ("after", []), ("after", [(50, 50)])), (1024, 512)),
        # Without one, the search goes on in the after capture.
        ((("before", []), ("after", []), ("after", [(10, 20)])), (1024, 512)),
        # Equal areas: the before capture's.
        ((("before", [(10, 20)]), ("after", [(20, 10)])), (1024, 512)),
    ],
)
def test_which_mask_decides_the_official_grid(pair, sides):
    assert official_grid(tracks(*pair), NOTHING)("after", 3) == sides


def test_without_truth_the_prediction_decides():
    empty = tracks()
    assert official_grid(empty, Prediction((), (480, 640)))("before", 0) == (768, 1024)
    assert official_grid(empty, NOTHING)("before", 0) == (1024, 576)
    reported = prediction((1.0, {"after": {2: of_size(480, 640)}}))
    assert strict_grid(truth(), reported)("after", 2) == (768, 1024)


@given(st.integers(1, 5000), st.integers(1, 5000))
def test_scaled_sides(first, second):
    a, b = scaled_to_long_side(first, second)
    assert max(a, b) == 1024
    assert min(a, b) >= 1
    assert abs(a * second - b * first) <= max(first, second)


def test_sides_round_half_to_even():
    """2048 x 5 halves to 2.5, which Python rounds to 2; 2048 x 7 to 3.5, rounded to 4."""
    assert scaled_to_long_side(2048, 5) == (1024, 2)
    assert scaled_to_long_side(2048, 7) == (1024, 4)
    assert scaled_to_long_side(10_000, 1) == (1024, 1)


def test_grids_do_not_depend_on_the_prediction_where_truth_exists():
    pair = truth({"before": {0: of_size(30, 40)}})
    reported = prediction((1.0, {"before": {0: of_size(99, 11)}}))
    for grid in (official_grid, strict_grid):
        assert grid(pair, reported)("before", 0) == grid(pair, NOTHING)("before", 0)
    assert np.prod(strict_grid(pair, reported)("before", 0)) == 1024 * 768
