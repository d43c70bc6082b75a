"""Two directions, one answer: nothing is said twice."""

import numpy as np

from baselines.threedgs_cd.merging import MergeConfig, as_published, merged
from baselines.threedgs_cd.poses import Motion
from baselines.threedgs_cd.searching import Found, Link
from scenediff_classic.change.changed_regions import ChangedRegion
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.types import TermScores, Video

MERGE = MergeConfig()


def _thing(video: Video, x: float) -> SceneObject:
    points = np.array([x, 0.0, 0.5]) + 0.01 * np.random.default_rng(0).normal(size=(40, 3))
    looks = np.array([1, 0, 0], np.float32)
    view = 0 if video == "before" else 1
    region = ChangedRegion(
        view, 0, np.ones((2, 2), bool), 0.9, TermScores(0.0, 0.0, 0.0), looks, points
    )
    return SceneObject(video, (region,))


def _shift(x: float, inliers: int = 9) -> Motion:
    transform = np.eye(4)
    transform[0, 3] = x
    return Motion(transform, 1, inliers)


def _found(into, out, links=()) -> Found:
    return Found(tuple(into), tuple(out), tuple(links), {})


def _places(changes) -> list[tuple[float | None, float | None]]:
    def place(side: SceneObject | None) -> float | None:
        return None if side is None else round(float(side.points[:, 0].mean()), 1)

    return [(place(c.before), place(c.after)) for c in changes]


def test_added_and_removed() -> None:
    forth = _found([_thing("after", 0.2)], [_thing("before", 0.6)])
    back = _found([_thing("before", 0.6)], [_thing("after", 0.2)])
    assert _places(merged(forth, back, 0.9, 0.01, MERGE)) == [(0.6, None), (None, 0.2)]


def test_a_moved_thing_is_one_change() -> None:
    forth = _found([_thing("after", 0.4)], [_thing("before", 0.1)], [Link(0, 0, _shift(0.3))])
    back = _found([_thing("before", 0.1)], [_thing("after", 0.4)], [Link(0, 0, _shift(-0.3))])
    (change,) = merged(forth, back, 0.9, 0.01, MERGE)
    assert _places([change]) == [(0.1, 0.4)]
    assert change.match is not None
    one_way = _found([_thing("before", 0.1)], [])
    assert _places(merged(forth, one_way, 0.9, 0.01, MERGE)) == [(0.1, 0.4)]


def test_published_reports_a_moved_thing_twice() -> None:
    forth = _found(
        [_thing("after", 0.4), _thing("after", 0.8)], [_thing("before", 0.1)],
        [Link(0, 0, _shift(0.3))],
    )  # fmt: skip
    back = _found([_thing("before", 0.1)], [_thing("after", 0.4)], [Link(0, 0, _shift(-0.3))])
    lone, moved = as_published(forth, back)
    assert _places(lone) == [(None, 0.8)]
    assert _places(moved) == [(None, 0.4), (0.1, None)]


def test_a_thing_that_stands_still_is_no_change() -> None:
    forth = _found([_thing("after", 0.1)], [_thing("before", 0.1)], [Link(0, 0, _shift(0.002))])
    back = _found([_thing("before", 0.1), _thing("before", 0.7)], [])
    assert _places(merged(forth, back, 0.9, 0.01, MERGE)) == [(0.7, None)]
    assert len(merged(forth, back, 0.9, 0.0, MERGE)) == 2


def test_more_keypoints_decide() -> None:
    forth = _found(
        [_thing("after", 0.4), _thing("after", 0.8)],
        [_thing("before", 0.1)],
        [Link(0, 0, _shift(0.3, 5))],
    )
    back = _found([_thing("before", 0.1)], [_thing("after", 0.8)], [Link(0, 0, _shift(-0.7, 9))])
    assert _places(merged(forth, back, 0.9, 0.01, MERGE)) == [(0.1, 0.8), (None, 0.4)]


def test_a_move_without_its_other_side_is_an_addition() -> None:
    forth = _found([_thing("after", 0.4)], [_thing("before", 0.1)], [Link(0, 0, _shift(0.3))])
    assert _places(merged(forth, _found([], []), 0.9, 0.01, MERGE)) == [(None, 0.4)]
