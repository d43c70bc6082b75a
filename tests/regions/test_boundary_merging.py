"""Regions follow objects, whatever else changes."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.regions.boundary_merging import BoundaryMergingRegions, filled_depth
from tests.plane_scene import BOOK, VASE, render


@pytest.fixture(scope="module")
def view():
    return render([VASE, BOOK], "before", 0, (0.0, 0.0, 0.0))


def best_iou(labels: np.ndarray, truth: np.ndarray) -> float:
    inside = np.bincount(labels[truth], minlength=labels.max() + 1)
    sizes = np.bincount(labels.ravel())
    return float((inside / (sizes + truth.sum() - inside)).max())


def test_each_card_is_one_region(view):
    regions = BoundaryMergingRegions()(view)
    for card in (VASE, BOOK):
        assert best_iou(regions.labels, np.abs(view.depth - card.z) < 1e-4) > 0.9


def test_regions_cover_the_picture_and_are_numbered_without_gaps(view):
    regions = BoundaryMergingRegions()(view)
    assert regions.labels.shape == view.shape
    assert np.array_equal(np.unique(regions.labels), np.arange(regions.count))


def test_depth_separates_what_looks_alike(view):
    grey = replace(view, image=np.full_like(view.image, 128))
    regions = BoundaryMergingRegions()(grey)
    assert best_iou(regions.labels, np.abs(view.depth - VASE.z) < 1e-4) > 0.8


def test_works_without_any_depth(view):
    blind = replace(view, depth=np.full(view.shape, np.nan, np.float32))
    regions = BoundaryMergingRegions()(blind)
    assert best_iou(regions.labels, np.abs(view.depth - VASE.z) < 1e-4) > 0.8


def test_a_plain_picture_without_depth_is_one_region(view):
    blank = replace(
        view,
        image=np.full_like(view.image, 90),
        depth=np.full(view.shape, np.nan, np.float32),
    )
    assert BoundaryMergingRegions()(blank).count == 1


def test_world_scale_does_not_matter(view):
    bigger = replace(view, depth=view.depth * 10)
    expected = BoundaryMergingRegions()(view).labels
    assert np.mean(BoundaryMergingRegions()(bigger).labels == expected) > 0.99


def test_unknown_depth_takes_the_nearest_known(view):
    depth = view.depth.copy()
    depth[40:45, 40:45] = np.nan
    filled = filled_depth(replace(view, depth=depth))
    assert np.isfinite(filled).all()
    assert filled[42, 42] == pytest.approx(view.depth[42, 42])
