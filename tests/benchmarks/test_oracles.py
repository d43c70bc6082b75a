"""The truth as a plug-in."""

from dataclasses import replace

import numpy as np
import pytest

from data_tools.benchmarks.oracles import MixedGeometry, TrueFeatures, TrueRegions
from data_tools.benchmarks.rendered_truth import RenderedTruth
from scenediff_classic.change.scale import rescaled
from scenediff_classic.protocols import silent
from scenediff_classic.types import Regions
from tests.benchmarks.cards_on_disk import CARDS, write_cards
from tests.change.running import Given, captures
from tests.plane_scene import BOOK, BOOK_ELSEWHERE, CLOCK, VASE, scene


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    folder = tmp_path_factory.mktemp("oracles") / "cards"
    write_cards(folder)
    return folder


@pytest.fixture(scope="module")
def true():
    return scene([VASE, BOOK], [BOOK_ELSEWHERE, CLOCK])


@pytest.fixture(scope="module")
def estimate(true):
    """Half the size, cameras a little off, some depth wrong, some unknown, some only guessed."""

    def worse(view):
        depth, measured = view.depth.copy(), view.measured.copy()
        depth[:10] = np.nan
        depth[10:20] *= 1.1
        measured[:10] = measured[20:30] = False
        camera = view.cam_from_world.copy()
        camera[0, 3] += 0.01
        return replace(view, depth=depth, measured=measured, cam_from_world=camera)

    return rescaled(replace(true, views=tuple(worse(v) for v in true.views)), 2.0)


def mixed(estimate, pair, tmp_path, **what):
    source = MixedGeometry(Given(estimate), pair / "truth_geometry.npz", **what)
    return source(*captures(estimate), tmp_path, silent).views


def test_true_cameras_keep_the_estimated_depth(estimate, true, pair, tmp_path) -> None:
    for view, e, t in zip(
        mixed(estimate, pair, tmp_path, cameras="true"), estimate.views, true.views, strict=True
    ):
        assert np.array_equal(view.cam_from_world, t.cam_from_world)
        assert np.allclose(view.depth, 2 * e.depth, rtol=1e-5, equal_nan=True)
        assert np.array_equal(view.measured, e.measured)


def test_true_depth_keeps_the_estimated_cameras(estimate, true, pair, tmp_path) -> None:
    for view, e, t in zip(
        mixed(estimate, pair, tmp_path, depth="true"), estimate.views, true.views, strict=True
    ):
        assert np.array_equal(view.cam_from_world, e.cam_from_world)
        assert np.allclose(view.depth, t.depth / 2, rtol=1e-5)
        assert view.measured.all()


def test_depth_can_be_corrected_without_filling_holes(estimate, true, pair, tmp_path) -> None:
    views = mixed(estimate, pair, tmp_path, depth="true where found")
    for view, e, t in zip(views, estimate.views, true.views, strict=True):
        assert np.isnan(view.depth[:10]).all()
        assert np.allclose(view.depth[10:], t.depth[10:] / 2, rtol=1e-5)
        assert np.array_equal(view.measured, e.measured)


def test_holes_can_be_filled_without_correcting_depth(estimate, true, pair, tmp_path) -> None:
    views = mixed(estimate, pair, tmp_path, depth="true where missing")
    for view, e, t in zip(views, estimate.views, true.views, strict=True):
        assert np.allclose(view.depth[:10], t.depth[:10] / 2, rtol=1e-5)
        assert np.array_equal(view.depth[10:20], e.depth[10:20])
        assert view.measured.all()


def tiles(view) -> Regions:
    """Squares of 15 pixels, with a strip that is of no region."""
    row, column = np.indices(view.shape) // 15
    labels = row * (column.max() + 1) + column
    labels = np.unique(labels, return_inverse=True)[1].reshape(view.shape).astype(np.int32)
    labels[labels == labels.max()] = -1
    return Regions(labels, int(labels.max()) + 1)


def test_true_regions_are_whole_things_and_the_rest_as_proposed(true, pair) -> None:
    truth, rest = RenderedTruth(pair), tiles
    for view in true.views:
        instances, regions = truth.instances(view), TrueRegions(truth, rest)(view)
        assert set(np.unique(regions.labels)) - {-1} == set(range(regions.count))
        for number in CARDS:
            labels = np.unique(regions.labels[instances == number])
            assert len(labels) <= 1
            assert not np.isin(regions.labels[instances != number], labels).any()
        room = instances == 0
        proposed = rest(view).labels[room]
        pieces = np.unique(np.c_[proposed, regions.labels[room]], axis=0)
        assert len(pieces) == len(np.unique(proposed))


def test_true_features_tell_things_apart_and_nothing_else(true, pair) -> None:
    features = TrueFeatures(RenderedTruth(pair), stride=1)
    old, new = (features(true.views[k])[::5, ::5].reshape(-1, 4) for k in (0, 4))
    before, after = (RenderedTruth(pair).instances(true.views[k])[::5, ::5] for k in (0, 4))
    assert np.array_equal(old @ new.T > 0.5, before.reshape(-1, 1) == after.ravel())
