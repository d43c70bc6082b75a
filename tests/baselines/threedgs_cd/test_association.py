"""Masks of several views are one thing if they are near and alike."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.threedgs_cd.association import (
    AssociationConfig,
    apart,
    associated,
    central,
    fullest_first,
    often_seen,
)
from scenediff_classic.change.changed_regions import ChangedRegion
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.types import TermScores
from tests.baselines.splat_change.scenes import both

CONFIG = AssociationConfig()


def _mask(view: int, x: float, looks: int = 0, label: int = 0) -> ChangedRegion:
    points = np.array([x, 0.0, 0.5]) + 0.005 * np.random.default_rng(view).normal(size=(30, 3))
    descriptor = np.eye(3, dtype=np.float32)[looks]
    terms = TermScores(0.0, 0.0, 0.0)
    return ChangedRegion(view, label, np.ones((2, 2), bool), 0.9, terms, descriptor, points)


def _groups(things: list[SceneObject]) -> list[list[tuple[int, int]]]:
    return [[(r.view, r.label) for r in t.regions] for t in things]


def test_things_gather_their_masks() -> None:
    views = [[_mask(0, 0.0), _mask(0, 0.3, label=1)], [_mask(1, 0.3)], [_mask(2, 0.0)]]
    assert _groups(associated(views, "after", CONFIG)) == [[(0, 0), (2, 0)], [(0, 1), (1, 0)]]


def test_near_but_not_alike() -> None:
    views = [[_mask(0, 0.0, looks=0)], [_mask(1, 0.0, looks=1)]]
    assert len(associated(views, "after", CONFIG)) == 2


def test_one_mask_of_a_view_for_each_thing() -> None:
    views = [[_mask(0, 0.0)], [_mask(1, 0.0), _mask(1, 0.005, label=1)]]
    assert sorted(map(len, _groups(associated(views, "after", CONFIG)))) == [1, 2]


def test_things_that_the_first_view_lacks() -> None:
    views = [[_mask(0, 0.0)], [_mask(1, 0.3)], [_mask(2, 0.3)]]
    assert _groups(associated(views, "after", CONFIG)) == [[(0, 0)], [(1, 0), (2, 0)]]
    published = replace(CONFIG, late=False)
    assert _groups(associated(views, "after", published)) == [[(0, 0)], [(1, 0)], [(2, 0)]]


def test_fullest_views() -> None:
    views = [[_mask(0, 0.0)], [_mask(1, 0.0), _mask(1, 0.3, label=1)], []]
    assert [len(v) for v in fullest_first(views, CONFIG)] == [2, 1, 0]
    only = replace(CONFIG, fullest_only=True)
    assert [len(v) for v in fullest_first(views, only)] == [2]
    assert fullest_first([], only) == []


@pytest.mark.parametrize(("could_see", "kept"), [(True, 1), (False, 0)])
def test_views_that_could_show_it(could_see: bool, kept: int) -> None:
    geometry = both([], [])
    away = geometry.views[4].cam_from_world @ np.diag([-1.0, 1, -1, 1])  # looks the other way
    turned = tuple(
        replace(v, cam_from_world=away) if k in (4, 5) else v for k, v in enumerate(geometry.views)
    )
    thing = SceneObject("after", (_mask(3, 0.0),))
    config = replace(CONFIG, could_see=could_see, share=0.4)
    found = often_seen([thing], replace(geometry, views=turned), [3, 4, 5], config)
    assert len(found) == kept
    assert often_seen([thing], geometry, [3, 4, 5], config) == []  # the others could, and do not


def test_stray_points_do_not_count() -> None:
    points = np.concatenate(
        [np.zeros((98, 3)) + np.linspace(0, 0.01, 98)[:, None], np.ones((2, 3))]
    )
    kept = central(points, 0.98)
    assert len(kept) == 98
    assert kept.max() < 0.02
    assert len(central(np.zeros((0, 3)), 0.98)) == 0
    assert apart(points, np.zeros((0, 3))) == np.inf
