"""A thing has an outline of its own; a plain surface has none."""

import cv2
import numpy as np
import pytest

from baselines.splat_change.segmenting import GrabCutBoxes, Segment, parts
from tests.baselines.splat_change.scenes import iou
from tests.plane_scene import texture

WALL = cv2.resize(texture(0), (160, 120))
DISC = cv2.circle(np.zeros((120, 160), np.uint8), (80, 60), 20, 1, -1) > 0
BOX = (58, 38, 102, 82)


def _with_disc() -> np.ndarray:
    image = WALL.copy()
    image[DISC] = cv2.resize(texture(11), (160, 120))[DISC]
    return image


def test_a_disc_on_a_wall() -> None:
    segment = GrabCutBoxes()(_with_disc(), BOX)
    assert iou(segment.mask, DISC) > 0.9
    assert segment.score > 0.8


def test_a_wall_without_anything() -> None:
    grabcut = GrabCutBoxes()
    plain = np.full((120, 160, 3), 128, np.uint8)
    assert grabcut(plain, BOX).score < grabcut.least
    assert grabcut(WALL, BOX).score < grabcut.least


def test_same_box_same_mask() -> None:
    first, second = (GrabCutBoxes()(_with_disc(), BOX) for _ in range(2))
    assert np.array_equal(first.mask, second.mask)
    assert first.score == second.score


@pytest.mark.parametrize("box", [(0, 0, 3, 3), (0, 0, 160, 120), (157, 117, 160, 120)])
def test_boxes_without_room(box: tuple[int, int, int, int]) -> None:
    segment = GrabCutBoxes()(_with_disc(), box)
    assert segment.mask.shape == (120, 160)
    assert 0 <= segment.score <= 1


def test_parts_are_large_and_where_something_changed() -> None:
    mask = np.zeros((20, 40), bool)
    mask[2:12, 2:12] = mask[2:12, 20:30] = mask[16:18, 16:18] = True
    changed = np.zeros_like(mask)
    changed[:, :26] = True
    here = parts(Segment(mask, 0.7), 10, changed, 0.5)
    assert [int(p.mask.sum()) for p in here] == [100, 100]
    (one,) = parts(Segment(mask, 0.7), 10, changed, 0.7)
    assert one.mask[5, 5]
    assert one.score == 0.7
    assert len(parts(Segment(mask, 0.7), 1, changed, 0.0)) == 3
