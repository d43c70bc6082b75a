"""Which changed regions belong to one thing because they touch.

Classical regions split an object into its evenly coloured parts, where a learned segmenter would
give it whole. Two parts of one thing meet without a depth step from wherever they are seen; two
things that only overlap in one picture show a step there, or stand apart in the next one.
Where a part lies within another from wherever they are seen, as the inside of a bin does behind its
rim, the two are one thing across a depth step, too.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32


@dataclass(frozen=True)
class Border:
    """The common border of two regions of one view, in pixels."""

    smooth: float
    """Length without a depth step."""
    stepped: float
    """Length across which depth jumps, or is unknown on one side."""


def borders(
    labels: Int32[np.ndarray, "h w"], depth: Float32[np.ndarray, "h w"], step: float
) -> dict[tuple[int, int], Border]:
    """Borders between all regions that touch (4-neighbours), by label pair, the smaller first.

    Parameters
    ----------
    labels : int array
        -1 = no region.
    step : float
        Relative depth difference of neighbouring pixels that counts as a jump.
    """
    found = []
    with np.errstate(invalid="ignore", divide="ignore"):
        log_depth = np.log(depth)
    for axis in (0, 1):
        head = tuple(slice(None, -1) if k == axis else slice(None) for k in (0, 1))
        tail = tuple(slice(1, None) if k == axis else slice(None) for k in (0, 1))
        a, b = labels[head], labels[tail]
        cut = (a != b) & (a >= 0) & (b >= 0)
        gap = np.abs(log_depth[head] - log_depth[tail])[cut]
        smooth = np.nan_to_num(gap, nan=np.inf) <= step
        found.append(np.c_[np.minimum(a, b)[cut], np.maximum(a, b)[cut], smooth])
    rows = np.concatenate(found).astype(np.int64)
    pairs, owner = np.unique(rows[:, :2], axis=0, return_inverse=True)
    total = np.bincount(owner.ravel(), minlength=len(pairs))
    smooth = np.bincount(owner.ravel(), rows[:, 2], minlength=len(pairs))
    return {
        (int(a), int(b)): Border(float(s), float(t - s))
        for (a, b), s, t in zip(pairs, smooth, total, strict=True)
    }


@dataclass(frozen=True)
class Part:
    """A region as the joining sees it."""

    group: int
    view: int
    label: int
    area: float


def joined(
    parts: Sequence[Part],
    borders_of: Mapping[int, Mapping[tuple[int, int], Border]],
    least_share: float,
    least_length: float,
    enclosed: float = math.inf,
) -> list[set[int]]:
    """Sets of groups that are one thing, judged over all views in which they touch.

    Parameters
    ----------
    parts : sequence of Part
    borders_of : mapping
        View -> `borders` of that view.
    least_share : float
        Share of the common border that must be smooth.
    least_length : float
        Smooth length needed, as a fraction of the smaller part's size (square root of its area).
    enclosed : float
        Length of border, of any kind, in proportion to the smaller group's size in a view, at which
        one lies within the other: enough if so in most of the views that show both, two at least.
    """
    within = _within(parts, borders_of, enclosed)
    smooth: dict[tuple[int, int], float] = defaultdict(float)
    stepped: dict[tuple[int, int], float] = defaultdict(float)
    needed: dict[tuple[int, int], float] = defaultdict(float)
    for first, second, border in _meetings(parts, borders_of):
        key = first.group, second.group
        smooth[key] += border.smooth
        stepped[key] += border.stepped
        needed[key] += least_length * min(first.area, second.area) ** 0.5
    parent = {p.group: p.group for p in parts}

    def root(group: int) -> int:
        while parent[group] != group:
            group = parent[group]
        return group

    for a, b in sorted(smooth):
        length, jump = smooth[a, b], stepped[a, b]
        flat = length >= least_share * (length + jump) and length >= needed[a, b]
        if flat or (a, b) in within:
            parent[root(b)] = root(a)
    sets: dict[int, set[int]] = defaultdict(set)
    for group in parent:
        sets[root(group)].add(group)
    return [sets[key] for key in sorted(sets)]


def _meetings(
    parts: Sequence[Part], borders_of: Mapping[int, Mapping[tuple[int, int], Border]]
) -> Iterator[tuple[Part, Part, Border]]:
    """Parts of different groups that touch in a view, that of the smaller group number first."""
    at = {(p.view, p.label): p for p in parts}
    for view, found in borders_of.items():
        for (a, b), border in found.items():
            first, second = at.get((view, a)), at.get((view, b))
            if first is not None and second is not None and first.group != second.group:
                swapped = first.group > second.group
                yield (second, first, border) if swapped else (first, second, border)


def _within(
    parts: Sequence[Part],
    borders_of: Mapping[int, Mapping[tuple[int, int], Border]],
    enclosed: float,
) -> set[tuple[int, int]]:
    """Pairs of groups, the smaller number first, of which one lies within the other."""
    area: dict[tuple[int, int], float] = defaultdict(float)
    views: dict[int, set[int]] = defaultdict(set)
    for part in parts:
        area[part.view, part.group] += part.area
        views[part.group].add(part.view)
    length: dict[tuple[int, int, int], float] = defaultdict(float)
    for first, second, border in _meetings(parts, borders_of):
        length[first.view, first.group, second.group] += border.smooth + border.stepped
    votes: dict[tuple[int, int], int] = defaultdict(int)
    for (view, a, b), border in length.items():
        votes[a, b] += border >= enclosed * min(area[view, a], area[view, b]) ** 0.5
    return {(a, b) for (a, b), n in votes.items() if n >= 2 and 2 * n > len(views[a] & views[b])}


def adopted(
    parts: Sequence[Part],
    weak: Sequence[Part],
    borders_of: Mapping[int, Mapping[tuple[int, int], Border]],
    least_share: float,
    least_length: float,
) -> dict[tuple[int, int], int]:
    """Which group each weak part, by (view, label), belongs to: the one it has the longest smooth
    border with, in its own view.

    Left out are those that no group borders on smoothly, and those larger than all of a group's
    parts in the view: that would be what the thing stands on.

    Parameters
    ----------
    weak : sequence of Part
        Their `group` does not matter.
    parts, borders_of, least_share, least_length
        As in `joined`.
    """
    owner = {(p.view, p.label): p.group for p in parts}
    area: dict[tuple[int, int], float] = defaultdict(float)
    for part in parts:
        area[part.group, part.view] += part.area
    found = {}
    for part in weak:
        length: dict[int, float] = defaultdict(float)
        for pair, border in borders_of.get(part.view, {}).items():
            if part.label not in pair:
                continue
            group = owner.get((part.view, pair[pair[0] == part.label]))
            smooth = border.smooth >= least_share * (border.smooth + border.stepped)
            if group is not None and smooth and part.area <= area[group, part.view]:
                length[group] += border.smooth
        best = max(length, key=lambda group: (length[group], -group), default=None)
        if best is not None and length[best] >= least_length * part.area**0.5:
            found[part.view, part.label] = best
    return found
