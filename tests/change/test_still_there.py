"""What only looks different is left out, if the light differs."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.cameras import unproject
from scenediff_classic.change.changed_regions import ChangedRegion
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.change.scale import rescaled
from scenediff_classic.change.still_there import (
    StillThereConfig,
    measured_again,
    without_still_there,
)
from scenediff_classic.types import Geometry, TermScores
from tests.geometry.textured_room import room

MASK = np.zeros((48, 64), bool)
MASK[16:32, 20:40] = True
CONFIG = StillThereConfig()
DARK, SAME = 0.2, 0.02


@pytest.fixture(scope="module")
def geometry() -> Geometry:
    """A room that nobody touched, all of it measured."""
    before, depth = room(height=48, width=64, count=3)
    after, other = room(height=48, width=64, count=2, video="after")
    views = tuple(
        replace(v, depth=d, measured=np.isfinite(d))
        for v, d in zip((*before.views, *after.views), (*depth, *other), strict=True)
    )
    return replace(before, views=views)


def thing(geometry: Geometry) -> SceneObject:
    """What the first view shows in the mask."""
    points = unproject(geometry.views[0])[MASK].astype(float)
    region = ChangedRegion(
        0, 0, MASK, 0.3, TermScores(0.0, 0.4, 0.0), np.ones(4, np.float32) / 2, points
    )
    return SceneObject("before", (region,))


def nearer(geometry: Geometry, share: float) -> Geometry:
    """In the first view, the mask's depth is less by a share of it."""
    first, *others = geometry.views
    depth = np.where(MASK, first.depth * (1 - share), first.depth).astype(np.float32)
    return replace(geometry, views=(replace(first, depth=depth), *others))


def test_a_surface_that_both_measure_is_still_there(geometry: Geometry) -> None:
    assert measured_again(thing(geometry), geometry, 0.02) > 0.9
    assert without_still_there([thing(geometry)], geometry, DARK, CONFIG) == []


def test_in_the_same_light_looks_count(geometry: Geometry) -> None:
    painted = thing(geometry)
    assert without_still_there([painted], geometry, SAME, CONFIG) == [painted]
    off = replace(CONFIG, share=1.01)
    assert without_still_there([painted], geometry, DARK, off) == [painted]


def test_what_is_seen_through_is_gone(geometry: Geometry) -> None:
    stood = nearer(geometry, 0.2)
    removed = thing(stood)
    assert measured_again(removed, stood, 0.01) < 0.1
    assert without_still_there([removed], stood, DARK, CONFIG) == [removed]


def test_what_is_hidden_or_unmeasured_says_nothing(geometry: Geometry) -> None:
    behind = nearer(geometry, -0.2)
    assert measured_again(thing(behind), behind, 0.01) < 0.1
    for video in ("before", "after"):
        views = tuple(replace(v, measured=v.measured & (v.video != video)) for v in geometry.views)
        blind = replace(geometry, views=views)
        assert measured_again(thing(blind), blind, 0.01) == 0
        assert without_still_there([thing(blind)], blind, DARK, CONFIG) != []


def test_scale_makes_no_difference(geometry: Geometry) -> None:
    small = rescaled(geometry, 25.0)
    assert measured_again(thing(small), small, 0.01) == pytest.approx(
        measured_again(thing(geometry), geometry, 0.01), abs=0.01
    )
