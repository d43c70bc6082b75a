"""What counts as moved, and what is said of everything that does not."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.change.changed_regions import ChangedRegion
from scenediff_classic.change.moves import MoveConfig, judged, pair_moves, same_thing
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.types import TermScores, Video


def thing(video: Video, angle: float, size: float = 1.0) -> SceneObject:
    """An object whose descriptor points at `angle` degrees in a plane."""
    turn = np.deg2rad(angle)
    descriptor = np.array([np.cos(turn), np.sin(turn)], np.float32)
    points = np.linspace(0, size, 50)[:, None] * np.ones(3)
    mask = np.ones((2, 2), bool)
    region = ChangedRegion(0, 0, mask, 1.0, TermScores(1, 1, 1), descriptor, points)
    return SceneObject(video, (region,))


def kinds(objects: list[SceneObject], config: MoveConfig) -> list[str]:
    changes = pair_moves(objects, 0.9, config)
    return sorted(
        "moved" if c.before and c.after else "removed" if c.before else "added" for c in changes
    )


def test_the_most_similar_are_paired_first_and_only_once() -> None:
    first, better, rival = thing("before", 0), thing("after", 2), thing("after", 10)
    changes = pair_moves([first, rival, better], 0.9, MoveConfig())
    moved = next(c for c in changes if c.before)
    assert moved.after is better
    assert moved.match is not None
    assert moved.match.similarity == pytest.approx(np.cos(np.deg2rad(2)), abs=1e-6)
    left = next(c for c in changes if c.before is None)
    assert left.after is rival
    assert left.match is not None
    assert same_thing(left.match)  # alike as well, but its counterpart went to a better one


def test_a_match_is_kept_of_what_did_not_move() -> None:
    (removed, added) = pair_moves([thing("before", 0), thing("after", 60)], 0.9, MoveConfig())
    assert removed.match == added.match
    assert removed.match is not None
    assert removed.match.similarity == pytest.approx(0.5, abs=1e-6)
    assert removed.match.least == 0.9
    assert not same_thing(removed.match)
    (alone,) = pair_moves([thing("before", 0)], 0.9, MoveConfig())
    assert alone.match is None


def test_sizes_must_be_comparable_unless_that_is_turned_off() -> None:
    pair = [thing("before", 0), thing("after", 0, size=3)]
    assert kinds(pair, MoveConfig(0.9, max_size_ratio=2.5)) == ["added", "removed"]
    assert kinds(pair, MoveConfig(0.9, max_size_ratio=3.5)) == ["moved"]
    assert kinds(pair, MoveConfig(0.9, max_size_ratio=0)) == ["moved"]
    assert judged(*pair, 0.9, 2.5).size_ratio == pytest.approx(3)


def test_order_does_not_matter() -> None:
    some = [thing("before", 0), thing("before", 30), thing("after", 29), thing("after", 1)]
    assert kinds(some, MoveConfig()) == kinds(some[::-1], MoveConfig()) == ["moved", "moved"]


def test_a_piece_that_touches_a_moved_thing_and_looks_like_it_is_part_of_it() -> None:
    """A plant's leaves and its pot before, the whole plant after."""
    pot, leaves, plant = thing("before", 3), thing("before", 6), thing("after", 2, size=2)
    (region,) = leaves.regions
    leaves = SceneObject("before", (replace(region, points=region.points + 1),))
    (moved,) = pair_moves([leaves, pot, plant], 0.9, MoveConfig())
    assert moved.before is not None
    assert moved.before.regions == pot.regions + leaves.regions
    assert moved.after is not None
    assert moved.after.regions == plant.regions
    assert kinds([leaves, pot, plant], MoveConfig(reach=0)) == ["moved", "removed"]


def test_a_second_like_thing_beside_it_is_not_part_of_it() -> None:
    """Two copies side by side, one of which went away and the other was moved."""
    one, other, moved = thing("before", 3), thing("before", 6), thing("after", 2)
    (region,) = other.regions
    other = SceneObject("before", (replace(region, points=region.points + 1),))
    assert kinds([one, other, moved], MoveConfig()) == ["moved", "removed"]


def test_pieces_on_both_sides_find_each_other() -> None:
    some = [thing("before", 0), thing("before", 9), thing("after", 1), thing("after", 10)]
    assert kinds(some, MoveConfig()) == ["moved", "moved"]


def test_a_like_thing_elsewhere_is_not_part_of_it() -> None:
    far = thing("before", 5)
    region = far.regions[0]
    far = SceneObject("before", (replace(region, points=region.points + 5),))
    assert kinds([thing("before", 0), far, thing("after", 0)], MoveConfig()) == ["moved", "removed"]
