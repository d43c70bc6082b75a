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


def test_parts_known_to_differ_never_merge(view):
    """Two halves of a plain picture: one region each if they are things, told apart if supports."""
    blank = replace(
        view,
        image=np.full_like(view.image, 90),
        depth=np.full(view.shape, np.nan, np.float32),
    )
    cell = np.arange(view.shape[1]) // 10
    blank.image[:, cell % 2 == 1] = 94  # superpixels to choose from
    parts = np.repeat([0, 1], view.shape[1] // 2)[None].repeat(view.shape[0], 0).astype(np.int32)
    for whole in (0, 2):
        regions = BoundaryMergingRegions(scale=0.5).within(blank, parts, whole)
        assert np.array_equal(regions.labels, parts)
    unknown = np.full_like(parts, -1)
    assert BoundaryMergingRegions(scale=0.5).within(blank, unknown, 0).count == 1


def test_a_thing_of_many_colours_is_one_region(view):
    everything = np.zeros(view.shape, np.int32)
    assert BoundaryMergingRegions().within(view, everything, 1).count == 1
    assert BoundaryMergingRegions().within(view, everything, 0).count > 1


def test_unknown_depth_takes_the_nearest_known(view):
    depth = view.depth.copy()
    depth[40:45, 40:45] = np.nan
    filled = filled_depth(replace(view, depth=depth))
    assert np.isfinite(filled).all()
    assert filled[42, 42] == pytest.approx(view.depth[42, 42])
