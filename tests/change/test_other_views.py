"""Parts of an object that only its other views know to be changed."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.cameras import unproject
from scenediff_classic.change.changed_regions import ObjectConfig, scored_region
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.change.other_views import completed
from scenediff_classic.change.scale import normalised
from scenediff_classic.change.scoring import RegionScores, Scores
from scenediff_classic.types import Geometry, Regions
from tests.plane_scene import VASE, scene

WALL, LEFT, RIGHT = range(3)
CONFIG = ObjectConfig()


@pytest.fixture(scope="module")
def geometry() -> Geometry:
    """A vase before a wall, and the wall alone."""
    return normalised(scene([VASE], []))


@pytest.fixture(scope="module")
def proposals(geometry: Geometry) -> list[Regions]:
    """The wall, and the halves of the vase."""
    found = []
    for view in geometry.views:
        wall = view.depth > 0.99 * np.nanmax(view.depth)
        x = unproject(view)[..., 0] * geometry.unit
        right = x > VASE.x + VASE.width / 2
        found.append(Regions(np.where(wall, WALL, 1 + right).astype(np.int32), 3))
    return found


@pytest.fixture(scope="module")
def scores(geometry: Geometry) -> Scores:
    """Nothing that says that anything changed."""
    zero = np.zeros(3)
    regions = RegionScores(zero, zero, zero, zero, np.ones((3, 4), np.float32) / 2)
    return Scores((), (regions,) * len(geometry.views), (), {})


def thing(geometry, proposals, scores, *parts: tuple[int, int]) -> SceneObject:
    """Made of (view, label)."""
    regions = tuple(
        scored_region(
            k, label, proposals[k].labels == label, unproject(geometry.views[k]), scores, CONFIG
        )
        for k, label in parts
    )
    return SceneObject("before", regions)


def parts(item: SceneObject) -> set[tuple[int, int]]:
    return {(r.view, r.label) for r in item.regions}


VASES = {(k, label) for k in range(3) for label in (LEFT, RIGHT)}


@pytest.mark.parametrize(
    "missing", [{(2, RIGHT)}, {(2, LEFT), (2, RIGHT)}, {(0, LEFT), (2, RIGHT)}]
)
def test_what_other_views_show_is_part_of_it(geometry, proposals, scores, missing) -> None:
    item = thing(geometry, proposals, scores, *sorted(VASES - missing))
    (found,) = completed([item], geometry, proposals, scores, CONFIG)
    assert parts(found) == VASES  # neither the wall, nor a view of the other capture
    assert found.regions[: len(item.regions)] == item.regions


def test_it_can_be_turned_off(geometry, proposals, scores) -> None:
    item = thing(geometry, proposals, scores, (0, LEFT), (0, RIGHT), (1, LEFT))
    assert completed([item], geometry, proposals, scores, ObjectConfig(known_share=1.01)) == [item]


def test_another_object_keeps_what_it_has(geometry, proposals, scores) -> None:
    item = thing(geometry, proposals, scores, *sorted(VASES - {(2, RIGHT)}))
    other = thing(geometry, proposals, scores, (2, RIGHT))
    found = completed([item, other], geometry, proposals, scores, CONFIG)
    assert parts(found[0]) == parts(item)
    assert (2, RIGHT) in parts(found[1])


def test_a_region_that_is_mostly_something_else_stays_out(geometry, proposals, scores) -> None:
    item = thing(geometry, proposals, scores, (0, LEFT), (0, RIGHT), (1, LEFT), (1, RIGHT))
    bled = [*proposals[:2], Regions(np.zeros_like(proposals[2].labels), 3), *proposals[3:]]
    (found,) = completed([item], geometry, bled, scores, CONFIG)
    assert parts(found) == parts(item)


def test_without_depth_nobody_knows_where_a_region_lies(geometry, proposals, scores) -> None:
    item = thing(geometry, proposals, scores, (0, LEFT), (0, RIGHT), (1, LEFT), (1, RIGHT))
    blind = np.full_like(geometry.views[2].depth, np.nan)
    views = list(geometry.views)
    views[2] = replace(views[2], depth=blind)
    (found,) = completed([item], replace(geometry, views=tuple(views)), proposals, scores, CONFIG)
    assert parts(found) == parts(item)
