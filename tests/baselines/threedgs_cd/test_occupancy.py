"""Voxels that enough masks agree on are the thing, in all views."""

from dataclasses import replace

import numpy as np

from baselines.threedgs_cd.occupancy import OccupancyConfig, carved
from scenediff_classic.cameras import unproject
from scenediff_classic.change.changed_regions import ChangedRegion
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.types import TermScores
from tests.baselines.splat_change.scenes import both, iou, silhouette
from tests.plane_scene import VASE

CONFIG = OccupancyConfig()


def _thing(geometry, views) -> SceneObject:
    regions = []
    for k in views:
        mask = silhouette(geometry, k, 0.85)
        points = unproject(geometry.views[k])[mask].astype(np.float64)
        looks = np.ones(1, np.float32)
        regions.append(ChangedRegion(k, 0, mask, 0.9, TermScores(0, 0, 0), looks, points))
    return SceneObject("after", tuple(regions))


def test_all_views_show_it() -> None:
    geometry = both([], [VASE])
    thing = _thing(geometry, [3, 4])
    solid = carved(thing, geometry, [3, 4, 5], CONFIG)
    assert [r.view for r in solid.regions] == [3, 4, 5]
    for r in solid.regions:
        assert iou(r.mask, silhouette(geometry, r.view, 0.85)) > 0.7


def test_what_one_view_adds_is_cut_away() -> None:
    geometry = both([], [VASE])
    thing = _thing(geometry, [3, 4, 5])
    first = thing.regions[0]
    wide = first.mask.copy()
    wide[:, : wide.shape[1] // 2] = True
    solid = carved(
        replace(thing, regions=(replace(first, mask=wide), *thing.regions[1:])),
        geometry, [3, 4, 5], CONFIG,
    )  # fmt: skip
    assert iou(solid.regions[0].mask, first.mask) > 0.7


def test_masks_that_share_nothing_stay() -> None:
    geometry = both([], [VASE])
    thing = _thing(geometry, [3, 4])
    first = thing.regions[0]
    elsewhere = np.zeros_like(first.mask)
    elsewhere[-5:, -5:] = True
    odd = replace(thing, regions=(replace(first, mask=elsewhere), thing.regions[1]))
    assert carved(odd, geometry, [3, 4, 5], CONFIG) is odd
    empty = SceneObject("after", (replace(first, points=np.zeros((0, 3))),))
    assert carved(empty, geometry, [3], CONFIG) is empty


def test_surfaces_in_front_hide_it() -> None:
    geometry = both([], [VASE])
    thing = _thing(geometry, [3, 4])
    near = replace(geometry.views[5], depth=np.full(geometry.views[5].shape, 0.01, np.float32))
    covered = replace(geometry, views=(*geometry.views[:5], near))
    assert [r.view for r in carved(thing, covered, [3, 4, 5], CONFIG).regions] == [3, 4]
