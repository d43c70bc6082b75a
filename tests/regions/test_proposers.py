"""What every region proposer must do, on drawn views whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.cameras import pixel_centres
from scenediff_classic.protocols import RegionProposer
from scenediff_classic.regions.named import REGIONS
from scenediff_classic.regions.things_on_supports import ThingsOnSupportsRegions
from scenediff_classic.types import View
from tests.plane_scene import BOOK, VASE, render

HEIGHT, WIDTH, FOCAL = 120, 160, 150.0
TABLE, WALL, BOX = 0, 1, 2


def best_iou(labels: np.ndarray, truth: np.ndarray) -> float:
    inside = np.bincount(labels[truth], minlength=labels.max() + 1)
    sizes = np.bincount(labels.ravel())
    return float((inside / (sizes + truth.sum() - inside)).max())


def drawn(image: np.ndarray, depth: np.ndarray) -> View:
    blank = render([], "before", 0, (0.0, 0.0, 0.0), WIDTH, HEIGHT, FOCAL)
    depth = depth.astype(np.float32)
    return replace(blank, image=image, depth=depth, measured=np.isfinite(depth))


def box_on_table() -> tuple[View, np.ndarray]:
    """An upright box on a level table before a wall, in metres, and what every pixel shows.

    The camera is 0.8 m above the table and looks level. All is evenly coloured, but the box, whose
    front is printed in three bands.
    """
    x, y = np.moveaxis((pixel_centres(HEIGHT, WIDTH) - [WIDTH / 2, 30]) / FOCAL, -1, 0)
    box = (x * 2.0 > -0.2) & (x * 2.0 < 0.1) & (y * 2.0 > 0.44) & (y * 2.0 < 0.8)
    table = 0.8 / np.maximum(y, 1e-6)
    depth = np.minimum(table, 4.0)
    seen = np.where(table < 4.0, TABLE, WALL)
    depth[box], seen[box] = 2.0, BOX
    image = np.array([(140, 110, 80), (200, 200, 190), (0, 0, 0)], np.uint8)[seen]
    band = np.clip((y * 2.0 - 0.44) / 0.12, 0, 2).astype(int)
    colours = np.array([(200, 30, 30), (240, 240, 240), (30, 60, 180)], np.uint8)
    image[box] = colours[band[box]]
    view = drawn(image, depth)
    intrinsics = view.intrinsics.copy()
    intrinsics[1, 2] = 30
    return replace(view, intrinsics=intrinsics), seen


@pytest.fixture(params=[*REGIONS.values()], ids=[*REGIONS])
def proposer(request: pytest.FixtureRequest) -> RegionProposer:
    return request.param


@pytest.fixture(scope="module")
def cards() -> View:
    return render([VASE, BOOK], "before", 0, (0.0, 0.0, 0.0))


def with_holes(view: View, share: float) -> View:
    """Depth with 0.2 % noise, unknown at single pixels and in whole squares."""
    rng = np.random.default_rng(0)
    depth = view.depth * rng.normal(1, 0.002, view.shape).astype(np.float32)
    depth[rng.uniform(size=view.shape) < share] = np.nan
    for row, column in rng.integers(0, 80, (6, 2)):
        depth[row : row + 8, column : column + 8] = np.nan
    return replace(view, depth=depth, measured=np.isfinite(depth))


def test_labels_are_numbered_without_gaps(proposer: RegionProposer, cards: View) -> None:
    for view in (cards, box_on_table()[0], with_holes(box_on_table()[0], 0.1)):
        regions = proposer(view)
        assert regions.labels.shape == view.shape
        assert regions.labels.dtype == np.int32
        used = np.unique(regions.labels)
        assert np.array_equal(used[used >= 0], np.arange(regions.count))


def test_same_view_same_regions(proposer: RegionProposer) -> None:
    view = with_holes(box_on_table()[0], 0.1)
    np.testing.assert_array_equal(proposer(view).labels, proposer(view).labels)


def test_the_view_is_left_as_it_was(proposer: RegionProposer, cards: View) -> None:
    image, depth = cards.image.copy(), cards.depth.copy()
    proposer(cards)
    np.testing.assert_array_equal(cards.image, image)
    np.testing.assert_array_equal(cards.depth, depth)


@pytest.mark.parametrize("depth", [np.nan, 2.0])
def test_a_plain_picture_is_one_region(proposer: RegionProposer, depth: float) -> None:
    plain = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
    assert proposer(drawn(plain, np.full((HEIGHT, WIDTH), depth))).count == 1


def test_without_depth_colours_decide(proposer: RegionProposer, cards: View) -> None:
    blind = replace(
        cards,
        depth=np.full(cards.shape, np.nan, np.float32),
        measured=np.zeros(cards.shape, bool),
    )
    assert best_iou(proposer(blind).labels, np.abs(cards.depth - VASE.z) < 1e-4) > 0.8


def test_depth_separates_what_looks_alike(proposer: RegionProposer, cards: View) -> None:
    grey = replace(cards, image=np.full_like(cards.image, 128))
    assert best_iou(proposer(grey).labels, np.abs(cards.depth - VASE.z) < 1e-4) > 0.8


def test_a_flat_picture_is_cut_by_its_colours(proposer: RegionProposer) -> None:
    """A poster lies on its wall: depth cannot tell, so depth must not glue."""
    image = np.full((HEIGHT, WIDTH, 3), 200, np.uint8)
    poster = np.zeros((HEIGHT, WIDTH), bool)
    poster[30:80, 40:110] = True
    image[poster] = (150, 40, 40)
    labels = proposer(drawn(image, np.full((HEIGHT, WIDTH), 2.0))).labels
    assert best_iou(labels, poster) > 0.9


def test_the_unit_of_length_does_not_matter(proposer: RegionProposer) -> None:
    view, _ = box_on_table()
    bigger = replace(view, depth=view.depth * 10)
    assert np.mean(proposer(bigger).labels == proposer(view).labels) > 0.99


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_a_printed_box_on_a_table_is_one_thing(share: float) -> None:
    view, seen = box_on_table()
    labels = ThingsOnSupportsRegions()(with_holes(view, share) if share else view).labels
    assert best_iou(labels, seen == BOX) > 0.85
    parts = REGIONS["boundary-merging"](view).labels
    assert best_iou(parts, seen == BOX) < 0.5  # what the box's colours alone make of it


def test_a_thing_that_looks_like_its_table_is_told_from_it() -> None:
    view, seen = box_on_table()
    grey = replace(view, image=np.full_like(view.image, 128))
    labels = ThingsOnSupportsRegions()(grey).labels
    assert best_iou(labels, seen == BOX) > 0.8
