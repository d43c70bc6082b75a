"""Multi-view stereo on a small textured room with exact depth."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from scenediff_classic.geometry.stereo.depth_confidence import ConfidenceWeights
from scenediff_classic.geometry.stereo.depth_map import DepthMap
from scenediff_classic.geometry.stereo.multi_view import MultiViewStereo, StereoWork
from scenediff_classic.geometry.stereo.patchmatch import PatchMatch
from scenediff_classic.geometry.stereo.pyramid import upsample_planes
from scenediff_classic.protocols import silent
from scenediff_classic.types import Geometry, SparsePoints
from tests.geometry.textured_room import BOXES, room

QUICK = MultiViewStereo(PatchMatch(sweeps=(4, 2)), sources=3)
SIZE = {"height": 60, "width": 80, "count": 4}


def relative_error(geometry: Geometry, truth: tuple[np.ndarray, ...]) -> np.ndarray:
    """Relative depth errors of all measured pixels of all views."""
    return np.concatenate(
        [np.abs(v.depth / t - 1)[v.measured] for v, t in zip(geometry.views, truth, strict=True)]
    )


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Geometry, tuple[np.ndarray, ...]]:
    geometry, truth = room(**SIZE)
    return QUICK(geometry, tmp_path_factory.mktemp("stereo"), silent), truth


def test_confirmed_depth_is_right(solved) -> None:
    geometry, truth = solved
    error = relative_error(geometry, truth)
    assert np.mean(error < 0.02) > 0.88  # a window of 11 pixels is coarse in 80 columns
    assert np.median(error) < 0.005
    assert np.mean([v.measured.mean() for v in geometry.views]) > 0.33


def test_unknown_is_nan_with_no_confidence(solved) -> None:
    geometry, _ = solved
    for view in geometry.views:
        assert view.depth.dtype == view.confidence.dtype == np.float32
        known = np.isfinite(view.depth)
        assert np.array_equal(view.confidence > 0, known)
        assert known[view.measured].all()
        assert view.confidence.max() <= 1
        likely = known & ~view.measured
        assert view.confidence[view.measured].mean() > view.confidence[likely].mean()


def test_what_is_measured_goes_by_each_pixel_alone(tmp_path: Path) -> None:
    """The reported confidence looks around a pixel; what counts as evidence must not."""

    class Doubtful(PatchMatch):
        confidence_weights = ConfidenceWeights(-9.0, 0.0, 0.0, 0.0)

    geometry, _ = room(height=24, width=32, count=3)
    sure = replace(QUICK, matcher=PatchMatch(sweeps=(2,)))(geometry, tmp_path / "a", silent)
    doubt = replace(QUICK, matcher=Doubtful(sweeps=(2,)))(geometry, tmp_path / "b", silent)
    for a, b in zip(sure.views, doubt.views, strict=True):
        np.testing.assert_array_equal(a.measured, b.measured)
        np.testing.assert_array_equal(a.depth, b.depth)
        assert b.confidence.max() < 1e-3 < a.confidence.max()


def test_a_stricter_limit_measures_less(solved, tmp_path: Path) -> None:
    geometry, _ = solved
    work = StereoWork.of(QUICK, geometry, tmp_path, silent)
    strict = StereoWork.of(replace(QUICK, sure_likelihood=0.99), geometry, tmp_path, silent)
    first = work.first_pass()
    found = work.second_pass(first)
    for a, b in zip(work.confirmed(first, found), strict.confirmed(first, found), strict=True):
        assert 0 < b.measured.sum() < a.measured.sum()
        assert not (b.measured & ~a.measured).any()


def test_confidence_sorts_by_error(solved) -> None:
    geometry, truth = solved
    error = relative_error(geometry, truth)
    trust = np.concatenate([v.confidence[v.measured] for v in geometry.views])
    high = trust > np.median(trust)
    assert np.mean(error[high] < 0.01) > np.mean(error[~high] < 0.01)


def test_world_scale_only_scales_depth(solved, tmp_path: Path) -> None:
    geometry, _ = solved
    large, _ = room(**SIZE, scale=10.0)
    large = QUICK(large, tmp_path, silent)
    for small_view, large_view in zip(geometry.views, large.views, strict=True):
        both = small_view.measured & large_view.measured
        assert both.sum() > 0.97 * max(small_view.measured.sum(), large_view.measured.sum())
        ratio = large_view.depth[both] / small_view.depth[both]
        assert np.mean(np.abs(ratio / 10 - 1) < 1e-3) > 0.97  # rounding may flip near ties


def test_second_run_reuses_depth_maps_unless_something_changed(tmp_path: Path) -> None:
    geometry, _ = room(height=24, width=32, count=3)
    stereo = MultiViewStereo(PatchMatch(sweeps=(1,)))
    first = stereo(geometry, tmp_path, silent)
    files = sorted((tmp_path / "stereo").iterdir())
    assert [f.name for f in files] == [
        f"before_{i:05d}_{which}.npz" for i in range(3) for which in ("first", "second")
    ]
    stamps = [f.stat().st_mtime_ns for f in files]
    again = stereo(geometry, tmp_path, silent)
    assert [f.stat().st_mtime_ns for f in files] == stamps
    for a, b in zip(first.views, again.views, strict=True):
        np.testing.assert_array_equal(a.depth, b.depth)

    files[1].write_bytes(b"cut short")  # a damaged file is made again
    repaired = stereo(geometry, tmp_path, silent)
    np.testing.assert_array_equal(repaired.views[1].depth, first.views[1].depth)

    replace(stereo, matcher=PatchMatch(sweeps=(2,)))(geometry, tmp_path, silent)
    assert all(f.stat().st_mtime_ns != s for f, s in zip(files, stamps, strict=True))


def test_result_does_not_depend_on_the_number_of_threads(tmp_path: Path) -> None:
    numba = pytest.importorskip("numba")
    geometry, _ = room(height=24, width=32, count=3)
    many = MultiViewStereo(PatchMatch(sweeps=(2,)))(geometry, tmp_path / "many", silent)
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        one = MultiViewStereo(PatchMatch(sweeps=(2,)))(geometry, tmp_path / "one", silent)
    finally:
        numba.set_num_threads(before)
    for a, b in zip(many.views, one.views, strict=True):
        np.testing.assert_array_equal(a.depth, b.depth)


def test_works_without_sparse_points(tmp_path: Path) -> None:
    geometry, truth = room(**SIZE)
    bare = replace(geometry, points=SparsePoints.none())
    error = relative_error(QUICK(bare, tmp_path, silent), truth)
    assert len(error) > 0.3 * 4 * 60 * 80
    assert np.mean(error < 0.02) > 0.85


def test_ignored_pixels_get_no_depth(tmp_path: Path) -> None:
    geometry, _ = room(height=24, width=32, count=3)
    ignore = np.zeros((24, 32), bool)
    ignore[:, :10] = True
    views = tuple(replace(v, ignore=ignore) for v in geometry.views)
    result = MultiViewStereo(PatchMatch(sweeps=(2,)), sure_likelihood=0.5)(
        replace(geometry, views=views), tmp_path, silent
    )
    assert all(np.isnan(v.depth[ignore]).all() for v in result.views)
    assert any(v.measured.any() for v in result.views)


def test_view_alone_gets_no_depth(tmp_path: Path) -> None:
    geometry, _ = room(height=24, width=32, count=1)
    (view,) = MultiViewStereo()(geometry, tmp_path, silent).views
    assert not view.measured.any()
    assert np.isnan(view.depth).all()


def test_depth_does_not_see_the_other_capture(tmp_path: Path) -> None:
    """With enough views of its own, a capture's depth ignores what the other one looks like."""
    before, _ = room(height=24, width=32, count=3)
    after, _ = room(height=24, width=32, count=3, video="after")
    black = tuple(replace(v, image=np.zeros_like(v.image)) for v in after.views)
    stereo = MultiViewStereo(PatchMatch(sweeps=(1,)), enough_sources=2)
    one = stereo(replace(before, views=before.views + after.views), tmp_path / "a", silent)
    two = stereo(replace(before, views=before.views + black), tmp_path / "b", silent)
    for a, b in zip(one.of("before"), two.of("before"), strict=True):
        np.testing.assert_array_equal(a.depth, b.depth)


def test_upsampled_planes_are_the_same_planes() -> None:
    y, x = np.mgrid[0:6, 0:8] + 0.5
    gx, gy = np.float32(0.03), np.float32(-0.01)
    planes = np.stack([1 + gx * x + gy * y, np.full_like(x, gx), np.full_like(x, gy)], -1)
    fine = upsample_planes(planes.astype(np.float32), (12, 16))
    y, x = np.mgrid[0:12, 0:16] + 0.5
    np.testing.assert_allclose(fine[..., 0], 1 + gx * x / 2 + gy * y / 2, rtol=1e-5)
    np.testing.assert_allclose(fine[..., 1:], np.broadcast_to([gx / 2, gy / 2], (12, 16, 2)))


def test_object_of_one_capture_stays_in_its_depth_beside_borrowed_sources(tmp_path: Path) -> None:
    """Three views of a room with a box, filled up by five of the room without it."""
    with_box, truth = room(**{**SIZE, "count": 3})
    without, empty = room(**{**SIZE, "count": 5}, video="after", boxes=BOXES[:-1])
    both = Geometry(with_box.views + without.views, SparsePoints.none())
    solved = MultiViewStereo(PatchMatch(sweeps=(4, 2)), sources=6)(both, tmp_path, silent)
    bare, _ = room(**{**SIZE, "count": 3}, boxes=BOXES[:-1])
    for view, true, plain in zip(solved.of("before"), truth, bare.views, strict=True):
        box = np.any(view.image != plain.image, axis=-1) & (true < 2.0)
        inner = cv2.erode(box.astype(np.uint8), np.ones((5, 5))) > 0
        assert inner.sum() > 50
        kept = inner & view.measured
        assert kept.sum() > 0.4 * inner.sum()
        assert np.mean(np.abs(view.depth[kept] / true[kept] - 1) < 0.02) > 0.9
    behind = solved.of("after")[2]  # where the box is missing, its depth does not appear
    assert (
        np.mean(np.abs(behind.depth[behind.measured] / empty[2][behind.measured] - 1) < 0.02) > 0.9
    )


def test_second_pass_mends_what_the_sources_contradict() -> None:
    geometry, truth = room(**SIZE)
    view, true = geometry.views[1], truth[1]
    others = [replace(v, depth=t) for v, t in zip(geometry.views, truth, strict=True)]
    del others[1]
    planes = np.zeros((*view.shape, 3), np.float32)
    planes[..., 0] = 1 / true
    planes[..., 2], planes[..., 1] = np.gradient(1 / true)
    hole = np.s_[20:32, 30:46]
    planes[hole] *= 1.3
    settled = np.ones(view.shape, bool)
    settled[hole] = False
    found = DepthMap(1 / planes[..., 0], np.full(view.shape, 0.1, np.float32), planes)
    mended = PatchMatch().revise(view, others, np.zeros((0, 3)), found, settled)
    error = np.abs(mended.depth / true - 1)
    assert np.all(np.abs(found.depth / true - 1)[hole] > 0.2)
    assert np.mean(error[hole] < 0.02) > 0.7
    assert np.mean(error[hole] < 0.05) > 0.8
    assert np.mean(error[settled] < 0.02) > 0.8  # only smoothed
