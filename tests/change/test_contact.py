"""Joining regions that touch without a depth step, judged over all views."""

import numpy as np

from scenediff_classic.change.contact import Border, Part, adopted, borders, joined

LABELS = np.array([[0, 0, 1, 1], [0, 0, 1, 1], [2, 2, 2, -1]], np.int32)


def test_border_lengths_and_steps():
    depth = np.array([[1, 1, 1, 1], [1, 1, 1.5, 1], [1, 1, 1, np.nan]], np.float32)
    found = borders(LABELS, depth, 0.02)
    assert found == {
        (0, 1): Border(smooth=1, stepped=1),
        (0, 2): Border(smooth=2, stepped=0),
        (1, 2): Border(smooth=0, stepped=1),
    }


def test_unknown_depth_does_not_join():
    found = borders(LABELS, np.full((3, 4), np.nan, np.float32), 0.02)
    assert all(border.smooth == 0 for border in found.values())


def parts(*groups: int) -> list[Part]:
    """Group k is label k in every view; all of area 100."""
    return [Part(group, view, group, 100.0) for view in (0, 1) for group in groups]


def test_parts_that_touch_smoothly_everywhere_are_one():
    seen = {0: {(0, 1): Border(20, 0)}, 1: {(0, 1): Border(15, 2)}}
    assert joined(parts(0, 1, 2), seen, 0.7, 0.2) == [{0, 1}, {2}]


def test_a_step_in_another_view_keeps_things_apart():
    seen = {0: {(0, 1): Border(20, 0)}, 1: {(0, 1): Border(0, 30)}}
    assert joined(parts(0, 1), seen, 0.7, 0.2) == [{0}, {1}]


def test_a_short_contact_is_not_enough():
    seen = {0: {(0, 1): Border(1, 0)}, 1: {}}
    assert joined(parts(0, 1), seen, 0.7, 0.2) == [{0}, {1}]


def test_joining_is_transitive_and_can_be_turned_off():
    seen = {0: {(0, 1): Border(20, 0), (1, 2): Border(20, 0)}, 1: {}}
    assert joined(parts(0, 1, 2), seen, 0.7, 0.2) == [{0, 1, 2}]
    assert joined(parts(0, 1, 2), seen, 1.01, 0.2) == [{0}, {1}, {2}]


def test_a_part_within_another_belongs_to_it_across_a_depth_step() -> None:
    """Areas of 100: size 10, so that a border of 20 is half an outline."""
    inside = {0: {(0, 1): Border(2, 19)}, 1: {(0, 1): Border(0, 22)}}
    assert joined(parts(0, 1), inside, 0.7, 0.2, 2.0) == [{0, 1}]
    assert joined(parts(0, 1), inside, 0.7, 0.2) == [{0}, {1}]
    beside = {0: {(0, 1): Border(0, 25)}, 1: {(0, 1): Border(0, 9)}}
    assert joined(parts(0, 1), beside, 0.7, 0.2, 2.0) == [{0}, {1}]


def test_one_view_alone_does_not_show_that_a_part_lies_within() -> None:
    once = [Part(0, 0, 0, 100.0), Part(1, 0, 1, 100.0)]
    assert joined(once, {0: {(0, 1): Border(0, 40)}}, 0.7, 0.2, 2.0) == [{0}, {1}]


def test_pieces_of_a_group_share_its_border_with_what_lies_within() -> None:
    """Group 0 is two regions around group 1, neither of which borders on enough of it."""
    around = [p for v in (0, 1) for p in (Part(0, v, 0, 400.0), Part(0, v, 2, 400.0))]
    seen = {v: {(0, 1): Border(0, 11), (1, 2): Border(0, 12)} for v in (0, 1)}
    within = [Part(1, v, 1, 100.0) for v in (0, 1)]
    assert joined(around + within, seen, 0.7, 0.2, 2.0) == [{0, 1}]


def test_a_weak_part_goes_to_the_thing_it_borders_on_longest() -> None:
    """View 0: strong parts 1 and 2 (groups 0 and 1), weak part 3 between them, weak support 4."""
    strong = [Part(0, 0, 1, 100), Part(1, 0, 2, 100)]
    weak = [Part(0, 0, 3, 50), Part(0, 0, 4, 5000), Part(0, 0, 5, 20)]
    found = {
        0: {
            (1, 3): Border(4, 0), (2, 3): Border(6, 1),
            (1, 4): Border(80, 0),  # what the thing stands on is larger than the thing
            (1, 5): Border(2, 8),  # mostly a depth step
        }
    }  # fmt: skip
    assert adopted(strong, weak, found, 0.7, 0.2) == {(0, 3): 1}
    assert adopted(strong, weak, found, 0.7, 2.0) == {}  # too short for either
    assert adopted(strong, weak, {}, 0.7, 0.2) == {}
