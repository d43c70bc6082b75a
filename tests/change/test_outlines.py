"""Outlines move to where the picture's colours change, and no farther than allowed."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.change.changed_regions import ChangedRegion
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.change.outlines import OutlineConfig, outline, redrawn
from scenediff_classic.types import Geometry, Lens, SparsePoints, TermScores, View

TRUE = np.zeros((60, 80), bool)
TRUE[20:40, 30:55] = True
"""Where the orange box is."""


@pytest.fixture
def view() -> View:
    """An orange box before a greenish wall, both a little uneven."""
    noise = np.random.default_rng(0).integers(-12, 13, (60, 80, 3))
    colour = np.where(TRUE[..., None], (210, 120, 40), (90, 110, 100))
    image = np.clip(colour + noise, 0, 255).astype(np.uint8)
    lens = Lens(80, 60, np.array([[70.0, 0, 40], [0, 70, 30], [0, 0, 1]]), np.zeros(4))
    depth = np.full((60, 80), 2, np.float32)
    return View(
        "before", 0, "a.png", image, lens.intrinsics, np.eye(4), depth, np.ones_like(depth),
        np.ones(depth.shape, bool), np.zeros(depth.shape, bool), lens,
    )  # fmt: skip


def shifted(rows: int, columns: int) -> np.ndarray:
    return np.roll(TRUE, (rows, columns), (0, 1))


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


def test_a_shifted_outline_finds_the_border(view: View) -> None:
    old = shifted(1, 2)
    new = outline(old, view, OutlineConfig())
    assert iou(new, TRUE) > 0.95
    assert iou(old, TRUE) < 0.83


def test_it_does_not_move_farther_than_its_reach(view: View) -> None:
    inside = np.zeros_like(TRUE)
    inside[27:33, 38:46] = True
    new = outline(inside, view, OutlineConfig(reach=0.3, most=100))
    rows, columns = np.nonzero(new)
    reach = 2  # 0.3 of the square root of 48 pixels
    assert rows.min() >= 27 - reach
    assert rows.max() < 33 + reach
    assert columns.min() >= 38 - reach
    assert columns.max() < 46 + reach


def test_where_colours_say_nothing_it_stays(view: View) -> None:
    plain = replace(view, image=np.full_like(view.image, 99))
    old = shifted(0, 0)
    new = outline(old, plain, OutlineConfig())
    assert new[old].mean() > 0.5  # never more than half given up for nothing
    everywhere = np.ones_like(old)
    np.testing.assert_array_equal(outline(everywhere, view, OutlineConfig()), everywhere)


def test_ignored_pixels_stay_outside(view: View) -> None:
    ignore = np.zeros_like(TRUE)
    ignore[:, 50:] = True
    new = outline(TRUE & ~ignore, replace(view, ignore=ignore), OutlineConfig())
    assert not new[ignore].any()


def test_the_same_each_time(view: View) -> None:
    first, second = (outline(shifted(2, 1), view, OutlineConfig()) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def a_region(mask: np.ndarray, label: int) -> ChangedRegion:
    return ChangedRegion(
        0, label, mask, 0.5, TermScores(0.1, 0.2, 0.3), np.ones(3, np.float32), np.zeros((1, 3))
    )


def test_parts_share_the_new_outline_without_overlap(view: View) -> None:
    old = shifted(1, 2)
    left = old.copy()
    left[:, 38:] = False
    item = SceneObject("before", (a_region(left, 1), a_region(old & ~left, 2)))
    geometry = Geometry((view,), SparsePoints.none())
    (new,) = redrawn([item], geometry, OutlineConfig())
    small, large = (r.mask for r in new.regions)
    assert not (small & large).any()
    np.testing.assert_array_equal(small | large, outline(old, view, OutlineConfig()))
    assert redrawn([item], geometry, OutlineConfig(rounds=0)) == [item]
