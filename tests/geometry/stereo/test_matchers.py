"""What every matcher has to do, on a small textured room with exact depth."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numba
import numpy as np
import pytest

from scenediff_classic.geometry.stereo.depth_map import DepthMap, Matcher
from scenediff_classic.geometry.stereo.patchmatch import PatchMatch
from scenediff_classic.geometry.stereo.plane_sweep import PlaneSweep
from scenediff_classic.types import View
from tests.geometry.textured_room import room

SIZE = {"height": 90, "width": 120, "count": 4}
NO_POINTS = np.empty((0, 3))


@pytest.fixture(params=[PatchMatch(sweeps=(4, 2)), PlaneSweep()], ids=lambda m: type(m).__name__)
def matcher(request: pytest.FixtureRequest) -> Matcher:
    return request.param


def searched(matcher: Matcher, **changes) -> tuple[DepthMap, np.ndarray]:
    """What is found for the second view in all the others, and the truth."""
    geometry, truth = room(**{**SIZE, **changes})
    view, *others = (geometry.views[i] for i in (1, 0, 2, 3))
    return matcher.search(view, others, geometry.points.xyz), truth[1]


def relative_error(depth: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.nan_to_num(np.abs(depth / truth - 1), nan=np.inf)


@contextmanager
def threads(count: int) -> Iterator[None]:
    before = numba.get_num_threads()
    numba.set_num_threads(count)
    try:
        yield
    finally:
        numba.set_num_threads(before)


def test_it_is_a_matcher(matcher: Matcher) -> None:
    assert isinstance(matcher, Matcher)
    assert hash(matcher) == hash(replace(matcher))


def test_depth_is_right(matcher: Matcher) -> None:
    found, truth = searched(matcher)
    error = relative_error(found.depth, truth)
    assert np.mean(error < 0.02) > 0.75
    assert np.median(error) < 0.008
    sure = found.cost < np.median(found.cost)
    assert np.mean(error[sure] < 0.02) > np.mean(error[~sure] < 0.02)


def test_types_and_ranges(matcher: Matcher) -> None:
    found, _ = searched(matcher)
    assert found.depth.dtype == found.cost.dtype == found.planes.dtype == np.float32
    assert found.depth.min() > 0
    assert found.cost.min() >= 0
    assert found.cost.max() <= 1
    np.testing.assert_allclose(found.depth * found.planes[..., 0], 1, rtol=1e-5)


def test_no_sources_no_depth(matcher: Matcher) -> None:
    geometry, _ = room(height=48, width=64, count=1)
    view = geometry.views[0]
    found = matcher.search(view, [], geometry.points.xyz)
    again = matcher.revise(view, [], geometry.points.xyz, found, np.zeros(view.shape, bool))
    for result in (found, again):
        assert np.isnan(result.depth).all()
        assert np.all(result.cost == 1)


def test_ignored_pixels_get_no_depth(matcher: Matcher) -> None:
    geometry, truth = room(**SIZE)
    ignore = np.zeros(geometry.views[0].shape, bool)
    ignore[:, :30] = True
    view, *others = (replace(geometry.views[i], ignore=ignore) for i in (1, 0, 2, 3))
    found = matcher.search(view, others, geometry.points.xyz)
    again = matcher.revise(view, others, geometry.points.xyz, found, np.zeros(view.shape, bool))
    for result in (found, again):
        assert np.isnan(result.depth[ignore]).all()
        assert np.mean(relative_error(result.depth, truth[1])[:, 60:] < 0.02) > 0.65


def test_the_unit_of_the_world_is_free(matcher: Matcher) -> None:
    small, _ = searched(matcher)
    large, _ = searched(matcher, scale=10.0)
    ratio = large.depth / small.depth
    assert np.mean(np.abs(ratio / 10 - 1) < 1e-3) > 0.95  # rounding may flip near ties


def test_exposure_of_a_source_hardly_matters(matcher: Matcher) -> None:
    geometry, truth = room(**SIZE)
    view, *others = (geometry.views[i] for i in (1, 0, 2, 3))
    dark = [replace(o, image=np.uint8(0.6 * o.image + 10)) for o in others]
    found = matcher.search(view, dark, geometry.points.xyz)
    usual = matcher.search(view, others, geometry.points.xyz)
    shares = [np.mean(relative_error(f.depth, truth[1]) < 0.02) for f in (found, usual)]
    assert shares[0] > shares[1] - 0.03


def test_same_answer_again_and_on_one_thread(matcher: Matcher) -> None:
    first, _ = searched(matcher)
    second, _ = searched(matcher)
    with threads(1):
        alone, _ = searched(matcher)
    for other in (second, alone):
        for name in ("depth", "cost", "planes"):
            np.testing.assert_array_equal(getattr(first, name), getattr(other, name))


def test_works_without_sparse_points(matcher: Matcher) -> None:
    geometry, truth = room(**SIZE)
    view, *others = (geometry.views[i] for i in (1, 0, 2, 3))
    found = matcher.search(view, others, NO_POINTS)
    assert np.mean(relative_error(found.depth, truth[1]) < 0.02) > 0.7


def test_revising_keeps_what_is_settled_and_helps_elsewhere(matcher: Matcher) -> None:
    geometry, truth = room(**SIZE)
    views: tuple[View, ...] = tuple(
        replace(v, depth=depth) for v, depth in zip(geometry.views, truth, strict=True)
    )
    view, *others = (views[i] for i in (1, 0, 2, 3))
    found = matcher.search(view, others, geometry.points.xyz)
    error = relative_error(found.depth, truth[1])
    settled = error < 0.02
    again = matcher.revise(view, others, geometry.points.xyz, found, settled)
    after = relative_error(again.depth, truth[1])
    assert np.mean(after[settled] < 0.03) > 0.95
    assert np.mean(after[~settled] < 0.02) > 0.1
