"""Support of a depth by other views, on exact depth."""

from dataclasses import replace

import numpy as np

from scenediff_classic.cameras import project, sample, unproject
from scenediff_classic.geometry.stereo.consistency import count_supporters
from scenediff_classic.types import View
from tests.geometry.textured_room import room


def exact_views() -> tuple[View, ...]:
    geometry, truth = room(height=60, width=80, count=3)
    return tuple(replace(v, depth=d) for v, d in zip(geometry.views, truth, strict=True))


def count(view: View, *others: View) -> np.ndarray:
    return count_supporters(view, others, max_pixels=1.5, max_relative=0.01)


def test_true_depth_is_supported_by_all_that_see_it() -> None:
    left, middle, right = exact_views()
    supporters = count(middle, left, right)
    surface = unproject(middle).astype(np.float64)
    for other in (left, right):
        xy, z = project(surface, other.intrinsics, other.cam_from_world)
        with np.errstate(invalid="ignore"):
            sees = np.abs(sample(other.depth, xy, nearest=True) / z - 1) < 0.005
        assert sees.mean() > 0.6
        assert np.mean(count(middle, other)[sees] == 1) > 0.99
    assert supporters.max() == 2


def test_wrong_depth_is_not_supported() -> None:
    left, middle, right = exact_views()
    wrong = replace(middle, depth=middle.depth * np.float32(1.05))
    assert np.mean(count(wrong, left, right) > 0) < 0.05
    slightly = replace(middle, depth=middle.depth * np.float32(1.003))
    assert np.mean(count(slightly, left, right) > 0) > 0.85


def test_unknown_depth_neither_gets_nor_gives_support() -> None:
    left, middle, _ = exact_views()
    unknown = replace(left, depth=np.full(left.shape, np.nan, np.float32))
    assert not count(middle, unknown).any()
    assert not count(unknown, middle).any()
    assert not count(middle).any()


def test_a_view_supports_itself_everywhere() -> None:
    _, middle, _ = exact_views()
    assert np.all(count(middle, middle) == 1)
