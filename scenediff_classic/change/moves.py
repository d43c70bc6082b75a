"""Object status: what is on both sides has moved (paper Sec. 4.3, "Object Status")."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from scenediff_classic.change.objects import SceneObject
from scenediff_classic.types import Match


@dataclass(frozen=True)
class MoveConfig:
    """When a removed and an added object are one that moved."""

    similarity: float | None = None
    """Least descriptor cosine (tau_sim); None = the feature back-end's own value."""
    max_size_ratio: float = 2.5
    """Largest ratio of the two objects' sizes; 0 = sizes are not compared, as in the paper."""
    reach: float = 0.02
    """A leftover object this close (normalised units) to one that moved, and as much like its
    counterpart, is a part of it if their sizes agree better then; 0 turns this off, as in the
    paper, whose regions are whole."""


@dataclass(frozen=True)
class Change:
    """An object of the before capture, of the after capture, or one that is in both."""

    before: SceneObject | None
    after: SceneObject | None
    match: Match | None
    """The two sides of a moved object, or the likeliest counterpart that was not the same thing."""


def pair_moves(
    objects: Sequence[SceneObject], default_similarity: float, config: MoveConfig
) -> list[Change]:
    """One-to-one greedy matching of before- with after-objects, most similar first."""
    least = default_similarity if config.similarity is None else config.similarity
    before = [o for o in objects if o.video == "before"]
    after = [o for o in objects if o.video == "after"]
    matches = {
        (i, j): judged(a, b, least, config.max_size_ratio)
        for i, a in enumerate(before)
        for j, b in enumerate(after)
    }
    ranked = sorted(matches, key=lambda pair: (-matches[pair].similarity, pair))
    changes, used_before, used_after = [], set(), set()
    for i, j in ranked:
        if not same_thing(matches[i, j]) or i in used_before or j in used_after:
            continue
        used_before.add(i)
        used_after.add(j)
        near = [
            [k for k in range(len(before)) if k not in used_before and same_thing(matches[k, j])],
            [k for k in range(len(after)) if k not in used_after and same_thing(matches[i, k])],
        ]
        parts = [
            [k for k in near[0] if touching(before[k], before[i], config.reach)],
            [k for k in near[1] if touching(after[k], after[j], config.reach)],
        ]
        match = matches[i, j]
        sides = before[i], after[j]
        if bool(parts[0]) != bool(parts[1]):  # in pieces on both sides: let them find each other
            whole = (
                united([before[i], *(before[k] for k in parts[0])]),
                united([after[j], *(after[k] for k in parts[1])]),
            )
            fuller = judged(*whole, least, config.max_size_ratio)
            if same_thing(fuller) and fuller.size_ratio < match.size_ratio:  # no second such thing
                sides, match = whole, fuller
                used_before.update(parts[0])
                used_after.update(parts[1])
        changes.append(Change(*sides, match))
    likeliest: tuple[dict[int, Match], dict[int, Match]] = {}, {}
    for pair in ranked:
        for side, number in zip(likeliest, pair, strict=True):
            side.setdefault(number, matches[pair])
    for i, o in enumerate(before):
        if i not in used_before:
            changes.append(Change(o, None, likeliest[0].get(i)))
    for j, o in enumerate(after):
        if j not in used_after:
            changes.append(Change(None, o, likeliest[1].get(j)))
    return changes


def touching(a: SceneObject, b: SceneObject, reach: float) -> bool:
    """Whether the two come closer than `reach` to each other."""
    if reach <= 0 or not len(a.points) or not len(b.points):
        return False
    nearest, _ = KDTree(a.points).query(b.points, distance_upper_bound=reach)
    return bool(np.isfinite(nearest).any())


def united(parts: Sequence[SceneObject]) -> SceneObject:
    """Several objects of one capture as one."""
    return SceneObject(parts[0].video, tuple(r for part in parts for r in part.regions))


def judged(a: SceneObject, b: SceneObject, least: float, most: float) -> Match:
    """How alike two objects of different captures are, beside what is asked of the same thing."""
    low, high = sorted((size_of(a), size_of(b)))
    return Match(float(a.descriptor @ b.descriptor), least, high / low if low > 0 else 0.0, most)


def same_thing(match: Match) -> bool:
    """Whether the two are one thing that moved."""
    sizes_agree = match.most <= 0 or 0 < match.size_ratio <= match.most
    return match.similarity > match.least and sizes_agree


def size_of(item: SceneObject) -> float:
    """Diagonal of the box between the 5th and 95th percentile of the object's points."""
    points = item.points
    if len(points) < 2:
        return 0.0
    low, high = np.percentile(points, [5, 95], axis=0)
    return float(np.linalg.norm(high - low))
