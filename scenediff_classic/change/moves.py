"""Object status: what is on both sides has moved (paper Sec. 4.3, "Object Status")."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scenediff_classic.change.objects import SceneObject


@dataclass(frozen=True)
class MoveConfig:
    """When a removed and an added object are one that moved."""

    similarity: float | None = None
    """Least descriptor cosine (tau_sim); None = the feature back-end's own value."""
    max_size_ratio: float = 2.5
    """Largest ratio of the two objects' sizes; 0 = sizes are not compared, as in the paper."""


@dataclass(frozen=True)
class Change:
    """An object of the before capture, of the after capture, or one that is in both."""

    before: SceneObject | None
    after: SceneObject | None
    similarity: float | None
    """Descriptor cosine of the two sides of a moved object."""


def pair_moves(
    objects: Sequence[SceneObject], default_similarity: float, config: MoveConfig
) -> list[Change]:
    """One-to-one greedy matching of before- with after-objects, most similar first."""
    least = default_similarity if config.similarity is None else config.similarity
    before = [o for o in objects if o.video == "before"]
    after = [o for o in objects if o.video == "after"]
    candidates = sorted(
        (-float(a.descriptor @ b.descriptor), i, j)
        for i, a in enumerate(before)
        for j, b in enumerate(after)
        if _similar_size(a, b, config.max_size_ratio)
    )
    changes, used_before, used_after = [], set(), set()
    for negative, i, j in candidates:
        if -negative <= least or i in used_before or j in used_after:
            continue
        used_before.add(i)
        used_after.add(j)
        changes.append(Change(before[i], after[j], -negative))
    changes += [Change(o, None, None) for i, o in enumerate(before) if i not in used_before]
    changes += [Change(None, o, None) for j, o in enumerate(after) if j not in used_after]
    return changes


def size_of(item: SceneObject) -> float:
    """Diagonal of the box between the 5th and 95th percentile of the object's points."""
    points = item.points
    if len(points) < 2:
        return 0.0
    low, high = np.percentile(points, [5, 95], axis=0)
    return float(np.linalg.norm(high - low))


def _similar_size(a: SceneObject, b: SceneObject, most: float) -> bool:
    sizes = size_of(a), size_of(b)
    return most <= 0 or min(sizes) * most >= max(sizes)
