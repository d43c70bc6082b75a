"""The ways to lay two captures over each other, found from each capture's own model.

If most things were moved by one and the same rigid motion, the moved things are a scene of their
own: two captures can be laid over each other by them as well as by what stayed. A joint
reconstruction then takes its matches from both and bends, or settles on either. Within one capture
nothing moves, so its own model is sound; and between two sound models every motion can be told.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from scenediff_classic.geometry.registration.similarity import (
    MIN_PAIRS,
    PointPairs,
    image_points,
    projection_matrices,
    strongest,
)
from scenediff_classic.geometry.registration.sparse_model import SparseModel

AMBIGUOUS = 0.12
"""Share of the ground, above which a second motion makes the alignment ambiguous. Single moved
things have up to 0.09 of it (measured on rendered pairs), half a room 0.15 to 0.5."""
_GRID = 12
"""Cells along each side of a picture in which ground is counted."""
_MOST = 4000
"""Points of each capture that are compared at most: those that most pictures see."""


@dataclass(frozen=True)
class Alignment:
    """One way to lay before over after."""

    motion: Float64[np.ndarray, "4 4"]
    """Similarity from the before model's world to the after model's."""
    pairs: Int64[np.ndarray, "k 2"]
    """(point before, point after) that fall onto each other."""
    ground: int
    """Cells of all pictures that hold one of them: points crowd on prints, ground does not."""
    depth: float
    """Median depth at which the pictures see them, as a multiple of that of all points."""


def ground_share(ways: tuple[Alignment, ...]) -> float:
    """Part of the weaker way in the ground of both, 0 to 0.5."""
    if len(ways) < 2:
        return 0.0
    return min(way.ground for way in ways) / max(sum(way.ground for way in ways), 1)


def alignments(
    before: SparseModel,
    after: SparseModel,
    looks_before: Float32[np.ndarray, "n d"],
    looks_after: Float32[np.ndarray, "m d"],
    seed: int = 0,
) -> tuple[Alignment, ...]:
    """The best way to lay before over after, and the best one of what is left; likelier first.

    The likelier one has more ground; but if that leaves it open (`AMBIGUOUS`), it is the one whose
    points lie farther away: a room is behind what stands in it.

    Parameters
    ----------
    looks_before, looks_after : array (points, d)
        What each point looks like, as unit vectors: see `looks_of`. Matches need not be certain:
        the motions tell right from wrong.
    """
    rng = np.random.default_rng(seed)
    free = _most_seen(before), _most_seen(after)
    found = []
    for _ in range(2):
        pairs = _alike(looks_before, looks_after, *free)
        test = PointPairs.of(before, after, pairs)
        motion, agree = strongest(test, rng)
        if agree.sum() < MIN_PAIRS:
            break
        kept = pairs[agree]
        ground = _ground(before, kept[:, 0]) + _ground(after, kept[:, 1])
        sides = ((before, kept[:, 0]), (after, kept[:, 1]))
        depth = float(np.mean([_relative_depth(model, points) for model, points in sides]))
        found.append(Alignment(motion, kept, ground, depth))
        near = pairs[test.follows(motion[None], 2.0)[0]]
        free[0][near[:, 0]] = free[1][near[:, 1]] = False
    unclear = ground_share(tuple(found)) >= AMBIGUOUS
    return tuple(sorted(found, key=lambda way: -way.depth if unclear else -way.ground))


def looks_of(
    model: SparseModel, descriptors: Iterable[UInt8[np.ndarray, "_ 128"]]
) -> Float32[np.ndarray, "n 128"]:
    """The mean descriptor of each point, of length 1.

    Parameters
    ----------
    descriptors : iterable of array
        Descriptors of all features of each picture; `SparseModel.features` counts them.
    """
    assert model.features is not None
    point, picture = model.points.observations.T
    looks = np.zeros((len(model.points.xyz), 128), np.float32)
    for number, found in enumerate(descriptors):
        here = picture == number
        looks[point[here]] += found[model.features[here]]  # a picture sees a point once only
    return looks / np.maximum(np.linalg.norm(looks, axis=1, keepdims=True), np.float32(1e-9))


def _most_seen(model: SparseModel) -> Bool[np.ndarray, "n"]:
    seen = np.bincount(model.points.observations[:, 0], minlength=len(model.points.xyz))
    chosen = np.zeros(len(seen), bool)
    chosen[np.argsort(-seen, kind="stable")[:_MOST]] = True
    return chosen


def _alike(
    looks_before: Float32[np.ndarray, "n d"],
    looks_after: Float32[np.ndarray, "m d"],
    free_before: Bool[np.ndarray, "n"],
    free_after: Bool[np.ndarray, "m"],
) -> Int64[np.ndarray, "k 2"]:
    """Free points that look more alike than either looks like any other free point."""
    first, second = np.flatnonzero(free_before), np.flatnonzero(free_after)
    if min(len(first), len(second)) == 0:
        return np.zeros((0, 2), np.int64)
    likeness = looks_before[first] @ looks_after[second].T
    best, back = likeness.argmax(axis=1), likeness.argmax(axis=0)
    mutual = back[best] == np.arange(len(first))
    return np.stack([first[mutual], second[best[mutual]]], axis=1)


def _ground(model: SparseModel, points: Int64[np.ndarray, "k"]) -> int:
    """Cells of the model's pictures that hold one of the points."""
    point, picture = model.points.observations.T
    held = np.isin(point, points)
    size = np.array([[p.lens.width, p.lens.height] for p in model.pictures])
    matrices = projection_matrices(model)[picture[held]]
    xy = image_points(model.points.xyz[point[held]][None], matrices)[0]
    xy *= size.max(axis=1)[picture[held], None] / size[picture[held]]
    cells = np.clip(np.nan_to_num(xy * _GRID), 0, _GRID - 1).astype(int)
    return len(np.unique(np.column_stack([picture[held], cells]), axis=0))


def _relative_depth(model: SparseModel, points: Int64[np.ndarray, "k"]) -> float:
    point, picture = model.points.observations.T
    ahead = np.array([p.cam_from_world[2] for p in model.pictures])[picture]
    depth = (ahead[:, :3] * model.points.xyz[point]).sum(axis=1) + ahead[:, 3]
    return float(np.median(depth[np.isin(point, points)]) / np.median(depth))
