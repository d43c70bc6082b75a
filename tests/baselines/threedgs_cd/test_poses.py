"""A thing that is found elsewhere tells how it moved."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.threedgs_cd.poses import Keypoints, PoseConfig, Template, keypoints, motion, template
from scenediff_classic.cameras import project
from tests.plane_scene import BOOK, BOOK_ELSEWHERE, WALL, render

CONFIG = PoseConfig()
CENTRES = ((-0.1, 0.0, 0.0), (0.1, -0.1, 0.0))
SIZE = {"width": 240, "height": 180, "focal": 220.0}


def _seen(card, centre):
    view = render([card], "before", 0, centre, **SIZE)
    return view, keypoints(view.image, view.depth < WALL.z - 0.3 - centre[2], CONFIG)


def test_the_book_moved() -> None:
    there, found_there = _seen(BOOK, CENTRES[0])
    here, found_here = _seen(BOOK_ELSEWHERE, CENTRES[1])
    answer = motion([template(found_there, there)], [(7, here, found_here)], CONFIG)
    assert answer is not None
    assert answer.view == 7
    assert answer.inliers >= 4
    middle = np.array([[BOOK.x + 0.2, BOOK.y + 0.25, BOOK.z]])
    shift = np.array([BOOK_ELSEWHERE.x - BOOK.x, BOOK_ELSEWHERE.y - BOOK.y, 0])
    np.testing.assert_allclose(answer(middle) - middle, shift[None], atol=0.06)


def test_nothing_to_find() -> None:
    there, found = _seen(BOOK, CENTRES[0])
    one = template(found, there)
    nothing = keypoints(there.image, np.zeros(there.shape, bool), CONFIG)
    assert len(nothing.xy) == 0
    assert motion([one], [(0, there, nothing)], CONFIG) is None
    assert motion([], [(0, there, found)], CONFIG) is None
    blank = keypoints(np.full((*there.shape, 3), 90, np.uint8), np.ones(there.shape, bool), CONFIG)
    assert len(blank.xy) == 0


@pytest.mark.parametrize(("count", "found"), [(3, False), (12, True)])
def test_few_keypoints_are_no_support(count: int, found: bool) -> None:
    view = render([BOOK], "before", 0, CENTRES[0], **SIZE)
    rng = np.random.default_rng(0)
    points = np.c_[rng.uniform(-0.5, 0.5, (count, 2)), rng.uniform(2, 3, count)]
    shifted = points + np.array([0.1, 0, 0])
    xy, _ = project(shifted, view.intrinsics, view.cam_from_world)
    looks = rng.normal(size=(count, 128)).astype(np.float32)
    one = Template(Keypoints(xy, looks), points)
    answer = motion([one], [(0, view, Keypoints(xy, looks))], CONFIG)
    assert (answer is not None) == found
    if answer is not None:
        assert answer.inliers == count
        np.testing.assert_allclose(answer(points), shifted, atol=1e-2)


def test_keypoints_without_depth_are_left_out() -> None:
    view, found = _seen(BOOK, CENTRES[0])
    half = view.depth.copy()
    half[:, : int(np.median(found.xy[:, 0]))] = np.nan
    kept = template(found, replace(view, depth=half))
    assert 0 < len(kept.points) < len(found.xy)
    assert np.isfinite(kept.points).all()
