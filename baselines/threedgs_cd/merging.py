"""Both directions as one answer in which nothing is said twice."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from baselines.threedgs_cd.poses import Motion
from baselines.threedgs_cd.searching import Found
from scenediff_classic.change.moves import Change, judged
from scenediff_classic.change.objects import SceneObject


@dataclass(frozen=True)
class MergeConfig:
    """When things of the two directions are the same."""

    near: float = 0.02
    """Points this close count as shared, in normalised units."""
    share: float = 0.3
    """Least share of a thing's points that must be shared."""


def merged(
    forth: Found, back: Found, least: float, still: float, config: MergeConfig
) -> list[Change]:
    """What stands in one capture alone, and what moved.

    Pictures of each capture show what the other one lacks. A thing that the model lost and that
    the pictures have elsewhere is tied to its own masks in the other direction; so a moved thing
    has masks in both captures, and is neither added nor removed beside.

    Parameters
    ----------
    forth : Found
        The before-model against the after-pictures.
    back : Found
        The after-model against the before-pictures.
    least : float
        Cosine that belongs to the features, for the record.
    still : float
        Things that moved less are no change.
    """
    pairs: list[tuple[int, int, Motion]] = []
    dropped: tuple[set[int], set[int]] = set(), set()
    for link in forth.links:
        twin = _same(forth.out[link.out], back.into, config)
        if _stands(link.motion, forth.out[link.out], still):
            dropped[1].add(link.into)
            dropped[0].update(() if twin is None else (twin,))
        elif twin is not None:
            pairs.append((twin, link.into, link.motion))
    for link in back.links:
        twin = _same(back.out[link.out], forth.into, config)
        if _stands(link.motion, back.out[link.out], still):
            dropped[0].add(link.into)
            dropped[1].update(() if twin is None else (twin,))
        elif twin is not None:
            pairs.append((link.into, twin, link.motion))
    changes, used = [], (set(dropped[0]), set(dropped[1]))
    for before, after, _ in sorted(pairs, key=lambda p: -p[2].inliers):
        if before in used[0] or after in used[1]:
            continue
        used[0].add(before)
        used[1].add(after)
        a, b = back.into[before], forth.into[after]
        changes.append(Change(a, b, judged(a, b, least, 0.0)))
    changes += [Change(a, None, None) for k, a in enumerate(back.into) if k not in used[0]]
    changes += [Change(None, b, None) for k, b in enumerate(forth.into) if k not in used[1]]
    return changes


def as_published(forth: Found, back: Found) -> tuple[list[Change], list[Change]]:
    """Both directions side by side: (added and removed, moved); a moved thing is there twice."""
    moved_after, moved_before = ({link.into for link in f.links} for f in (forth, back))
    lone = [Change(None, b, None) for k, b in enumerate(forth.into) if k not in moved_after]
    lone += [Change(a, None, None) for k, a in enumerate(back.into) if k not in moved_before]
    moved = [Change(None, forth.into[k], None) for k in sorted(moved_after)]
    moved += [Change(back.into[k], None, None) for k in sorted(moved_before)]
    return lone, moved


def _stands(motion: Motion, thing: SceneObject, still: float) -> bool:
    if not len(thing.points):
        return False
    path = np.linalg.norm(motion(thing.points) - thing.points, axis=1)
    return bool(np.median(path) < still)


def _same(thing: SceneObject, others: tuple[SceneObject, ...], config: MergeConfig) -> int | None:
    """Position of the thing at the same place, if there is one."""
    shares = [_shared(thing.points, other.points, config.near) for other in others]
    best = int(np.argmax(shares)) if shares else -1
    return best if best >= 0 and shares[best] >= config.share else None


def _shared(
    first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "m 3"], near: float
) -> float:
    """Share of the first points that lie near the second ones."""
    if not len(first) or not len(second):
        return 0.0
    return float((KDTree(second).query(first)[0] <= near).mean())
