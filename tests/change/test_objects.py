"""Which groups of changed regions are convincing enough to be objects."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.cameras import unproject
from scenediff_classic.change.changed_regions import ChangedRegion, ObjectConfig, pair_scores
from scenediff_classic.change.objects import established
from scenediff_classic.types import Geometry, TermScores
from tests.geometry.textured_room import room

THRESHOLD = 0.2
MASK = np.zeros((24, 32), bool)
MASK[8:16, 10:20] = True
CONFIG = ObjectConfig(min_area=10.0, merge_radius=0.5)


@pytest.fixture(scope="module")
def geometry() -> Geometry:
    before, depth = room(height=24, width=32, count=3)
    after, other = room(height=24, width=32, count=2, video="after")
    views = (*before.views, *after.views)
    return replace(
        before,
        views=tuple(replace(v, depth=d) for v, d in zip(views, (*depth, *other), strict=True)),
    )


def region(geometry: Geometry, view: int, *scores: float, area: int = 80) -> ChangedRegion:
    """A region of a before view, compared with views 3, 4, ... of the other capture."""
    mask = MASK & (np.cumsum(MASK).reshape(MASK.shape) <= area)
    return ChangedRegion(
        view, 0, mask, 0.3, TermScores(0.1, 0.4, 0.0), np.ones(4, np.float32) / 2,
        unproject(geometry.views[view])[mask].astype(float), tuple(enumerate(scores, 3)),
    )  # fmt: skip


def test_an_object_must_change_in_most_comparisons_of_two_views(geometry) -> None:
    def found(*scores: float, least: float = 0.75) -> int:
        group = [region(geometry, view, *scores) for view in range(3)]
        config = replace(CONFIG, min_agreement=least)
        return len(established([group], geometry, THRESHOLD, config))

    assert found(0.3, 0.3) == 1
    assert found(0.5, 0.1) == 0  # the mean is high, but half of the comparisons see no change
    assert found(0.5, 0.1, least=0.5) == 1
    assert found(0.5, 0.1, least=0) == 1
    assert found() == 1  # nothing was compared by pairs


def test_a_sliver_in_one_view_has_less_say_than_the_whole_thing_in_others(geometry) -> None:
    def found(area: int) -> int:
        whole = [region(geometry, view, 0.5, 0.5) for view in (0, 1)]
        sliver = region(geometry, 2, 0.1, 0.1, area=area)
        return len(established([[*whole, sliver]], geometry, THRESHOLD, CONFIG))

    assert found(80) == 0  # two thirds of the comparisons agree
    assert found(20) == 1  # eight ninths of what was compared


def test_an_object_must_be_shown_by_half_of_the_views_that_could(geometry) -> None:
    def found(views: int) -> int:
        group = [region(geometry, view, 0.3, 0.3) for view in range(views)]
        return len(established([group], geometry, THRESHOLD, replace(CONFIG, lone_margin=0)))

    assert [found(1), found(2), found(3)] == [0, 1, 1]


def test_regions_of_a_view_share_its_comparisons_by_area(geometry) -> None:
    parts = [region(geometry, 0, 0.4), region(geometry, 0, 0.1, area=40), region(geometry, 1, 0.2)]
    assert pair_scores(parts) == {(0, 3): pytest.approx(0.3), (1, 3): pytest.approx(0.2)}
    assert pair_scores([]) == {}
