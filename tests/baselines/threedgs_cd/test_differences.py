"""Otsu always splits; the floor says when there is nothing to split."""

import numpy as np

from baselines.threedgs_cd.differences import (
    DifferenceConfig,
    difference,
    differing,
    things,
    thresholds,
)
from tests.baselines.splat_change.scenes import both, iou, seen_by, silhouette
from tests.plane_scene import VASE

CONFIG = DifferenceConfig()


def test_only_the_new_thing_differs() -> None:
    geometry = both([], [VASE])
    shown = seen_by(geometry, "after")
    maps = {k: difference(geometry.views[k], r, CONFIG) for k, r in shown.items()}
    levels = thresholds(list(maps.values()), CONFIG)
    assert len(set(levels)) == 1
    for (k, values), level in zip(maps.items(), levels, strict=True):
        view, truth = geometry.views[k], silhouette(geometry, k, 0.85)
        assert np.nanmedian(values[truth]) > 2 * np.nanmedian(values[~truth])
        masks = things(view, shown[k], values, level, CONFIG)
        (into,) = masks.into
        assert iou(into.mask, truth) > 0.8
        assert masks.changed[truth].mean() > 0.8


def test_nothing_differs_between_equal_captures() -> None:
    geometry = both([VASE], [VASE])
    shown = seen_by(geometry, "after")
    maps = [difference(geometry.views[k], r, CONFIG) for k, r in shown.items()]
    for values, level in zip(maps, thresholds(maps, CONFIG), strict=True):
        assert level == CONFIG.floor
        assert differing(values, level, CONFIG.min_area) == []
    published = DifferenceConfig(floor=0.0, pooled=False)
    split = zip(maps, thresholds(maps, published), strict=True)
    assert any(len(differing(values, level, 0.003)) for values, level in split)


def test_otsu_between_two_levels() -> None:
    values = np.concatenate([np.full(90, 0.1), np.full(10, 0.7)]).reshape(10, 10)
    (level,) = thresholds([values], DifferenceConfig(floor=0.0))
    assert 0.1 <= level < 0.7
    assert thresholds([np.full((4, 4), np.nan)], CONFIG) == [np.inf]
    assert thresholds([], CONFIG) == []


def test_outlines_are_filled_and_small_ones_dropped() -> None:
    values = np.zeros((50, 60), np.float32)
    values[10:30, 10:30] = 1
    values[15:25, 15:25] = 0  # a hole
    values[40:42, 40:42] = 1
    values[0:5, 50:60] = np.nan
    ((mask, box),) = differing(values, 0.5, 0.01)
    assert mask.sum() == 400
    assert box == (10, 10, 30, 30)
    assert len(differing(values, 0.5, 0.001)) == 2
