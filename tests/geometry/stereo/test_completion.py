"""Guessed depth: on planes, inside colour edges, near support, and marked."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.geometry.stereo.completion import DepthCompletion, fit_plane
from scenediff_classic.types import Geometry, SparsePoints, View
from tests.geometry.textured_room import room

HEIGHT, WIDTH = 60, 80
NEAR_PLANE = np.array([0.002, 0.001, 0.9])
FAR_PLANE = np.array([-0.001, 0.002, 0.3])


def two_planes() -> tuple[View, np.ndarray]:
    """Left a red near plane, right a blue far one; all measured but a hole in each."""
    rows, cols = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    grid = np.stack([cols, rows, np.ones_like(rows)], axis=-1)
    left = cols < 40
    truth = (1 / np.where(left, grid @ NEAR_PLANE, grid @ FAR_PLANE)).astype(np.float32)
    image = np.where(left[..., None], [200, 40, 40], [40, 40, 200]).astype(np.uint8)
    measured = np.ones((HEIGHT, WIDTH), bool)
    measured[20:40, 30:50] = False  # across the edge
    view = room(height=HEIGHT, width=WIDTH, count=1)[0].views[0]
    return replace(
        view,
        image=image,
        depth=np.where(measured, truth, np.float32(np.nan)),
        confidence=np.where(measured, np.float32(0.8), np.float32(0)),
        measured=measured,
    ), truth


# The hole's middle is 10 pixels from its rim, in a picture of 80.
WIDE = DepthCompletion(max_distance=0.2)


def test_hole_across_an_edge_is_filled_from_both_sides() -> None:
    view, truth = two_planes()
    filled = WIDE.complete(view)
    away = np.abs(np.arange(WIDTH) + 0.5 - 40) > 3  # the edge's mixed colours may stay unknown
    np.testing.assert_allclose(filled.depth[:, away], truth[:, away], rtol=1e-3)


def test_guesses_are_marked_and_measured_depth_is_untouched() -> None:
    view, _ = two_planes()
    geometry = WIDE(Geometry((view,), SparsePoints.none()))
    filled = geometry.views[0]
    assert np.array_equal(filled.measured, view.measured)
    assert np.array_equal(filled.depth[view.measured], view.depth[view.measured])
    assert np.array_equal(filled.confidence[view.measured], view.confidence[view.measured])
    guessed = np.isfinite(filled.depth) & ~filled.measured
    assert 300 < guessed.sum() <= 400
    assert np.all(filled.confidence[guessed] <= 0.4 + 1e-6)  # half of what it was made from
    assert np.all(filled.confidence[guessed] > 0.3)


def test_far_from_support_depth_stays_unknown() -> None:
    view, _ = two_planes()
    filled = replace(WIDE, max_distance=0.05).complete(view)
    assert np.isnan(filled.depth[28:32, 38:42]).all()  # more than 4 pixels from any rim
    assert np.isfinite(filled.depth[21, 31:37]).all()


def test_patch_without_support_stays_unknown() -> None:
    view, _ = two_planes()
    measured = view.measured.copy()
    measured[:, 40:] = False
    depth = np.where(measured, view.depth, np.float32(np.nan))
    filled = WIDE.complete(replace(view, measured=measured, depth=depth))
    assert np.isnan(filled.depth[:, 42:]).all()  # nothing bleeds over the colour edge


def test_patch_that_is_no_plane_stays_unknown() -> None:
    view, _ = two_planes()
    depth = view.depth * np.random.default_rng(0).uniform(0.8, 1.2, view.depth.shape)
    filled = WIDE.complete(replace(view, depth=depth.astype(np.float32)))
    assert np.array_equal(np.isfinite(filled.depth), view.measured)


def test_ignored_pixels_and_unmeasured_views_get_no_guess() -> None:
    view, _ = two_planes()
    ignore = np.zeros((HEIGHT, WIDTH), bool)
    ignore[25:35, 35:45] = True
    filled = WIDE.complete(replace(view, ignore=ignore))
    assert np.isnan(filled.depth[ignore]).all()
    bare = room(height=24, width=32, count=1)[0].views[0]
    assert np.isnan(WIDE.complete(bare).depth).all()


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_plane_is_found_among_outliers_at_any_scale(scale: float) -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 100, (200, 2))
    plane = np.array([0.003, -0.002, 1.0]) / scale
    inverse = np.c_[xy, np.ones(200)] @ plane
    wrong = np.arange(200) % 5 == 0
    inverse[wrong] *= 1.5
    found, on_plane = fit_plane(xy, inverse, 0.01, np.random.default_rng(1))
    np.testing.assert_allclose(found, plane, rtol=1e-6)
    assert np.array_equal(on_plane, ~wrong)
