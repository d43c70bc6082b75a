"""The ways to lay two captures over each other, found from each capture's own model.

If most things were moved by one and the same rigid motion, the moved things are a scene of their
own: two captures can be laid over each other by them as well as by what stayed. A joint
reconstruction then takes its matches from both and bends, or settles on either. Within one capture
nothing moves, so its own model is sound; and between two sound models every motion can be told.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64, UInt8

from scenediff_classic.geometry.registration.sparse_model import PosedPicture, SparseModel
from scenediff_classic.types import SparsePoints

TOLERANCE = 0.006
"""Distance in the picture, as a share of its longer side, at which two points agree."""
MIN_PAIRS = 12
"""Pairs without which a motion is not told from chance."""
AMBIGUOUS = 0.12
"""Share of the ground, above which a second motion makes the alignment ambiguous. Single moved
things have up to 0.09 of it (measured on rendered pairs), half a room 0.15 to 0.5."""
_GRID = 12
"""Cells along each side of a picture in which ground is counted."""
_MOST = 4000
"""Points of each capture that are compared at most: those that most pictures see."""
_TRIALS = 40000
"""Three pairs each, drawn at random."""
_KEPT = 600
"""Trials that span triangles of one shape; only they are tried on all pairs."""
_WIDE = 0.1
"""Shortest side of such a triangle, as a share of the median distance from the middle."""
_STRETCH = 0.06
"""Largest relative difference in shape of two triangles."""
_CHUNK = 40
"""Trials that are tried at once: a matter of memory alone."""


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
        test = _Test.of(before, after, pairs)
        motion, agree = _strongest(test, rng)
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


def join(before: SparseModel, after: SparseModel, alignment: Alignment) -> SparseModel:
    """Both models in the world of the after model; points that fall onto each other are one."""
    scale = np.cbrt(np.linalg.det(alignment.motion[:3, :3]))
    turn, shift = alignment.motion[:3, :3] / scale, alignment.motion[:3, 3]
    moved = []
    for picture in before.pictures:
        pose = np.eye(4)
        pose[:3, :3] = picture.cam_from_world[:3, :3] @ turn.T
        pose[:3, 3] = scale * picture.cam_from_world[:3, 3] - pose[:3, :3] @ shift
        moved.append(replace(picture, cam_from_world=pose))
    number = len(after.points.xyz) + np.arange(len(before.points.xyz))
    number[alignment.pairs[:, 0]] = alignment.pairs[:, 1]
    xyz = np.concatenate([after.points.xyz, _carried(before.points.xyz, alignment.motion)])
    xyz[alignment.pairs[:, 1]] += xyz[len(after.points.xyz) + alignment.pairs[:, 0]]
    xyz[alignment.pairs[:, 1]] /= 2
    point, picture = before.points.observations.T
    moved_observations = np.stack([number[point], picture + len(after.pictures)], axis=1)
    observations = np.concatenate([after.points.observations, moved_observations])
    rgb = np.concatenate([after.points.rgb, before.points.rgb])
    used, observations[:, 0] = np.unique(observations[:, 0], return_inverse=True)
    order = np.lexsort((observations[:, 1], observations[:, 0]))
    weights = [len(after.points.observations), len(before.points.observations)]
    return SparseModel(
        (*after.pictures, *moved),
        SparsePoints(xyz[used], rgb[used], observations[order]),
        float(np.average([after.error, before.error], weights=weights)),
        _joined(after.keypoints, before.keypoints, order),
        _joined(after.features, before.features, order),
    )


def _joined(
    first: np.ndarray | None, second: np.ndarray | None, order: Int64[np.ndarray, "m"]
) -> np.ndarray | None:
    if first is None or second is None:
        return None
    return np.concatenate([first, second])[order]


def _ground(model: SparseModel, points: Int64[np.ndarray, "k"]) -> int:
    """Cells of the model's pictures that hold one of the points."""
    point, picture = model.points.observations.T
    held = np.isin(point, points)
    size = np.array([[p.lens.width, p.lens.height] for p in model.pictures])
    projections = _projections(model)[picture[held]]
    xy = _seen(model.points.xyz[point[held]][None], projections)[0]
    xy *= size.max(axis=1)[picture[held], None] / size[picture[held]]
    cells = np.clip(np.nan_to_num(xy * _GRID), 0, _GRID - 1).astype(int)
    return len(np.unique(np.column_stack([picture[held], cells]), axis=0))


def _relative_depth(model: SparseModel, points: Int64[np.ndarray, "k"]) -> float:
    point, picture = model.points.observations.T
    ahead = np.array([p.cam_from_world[2] for p in model.pictures])[picture]
    depth = (ahead[:, :3] * model.points.xyz[point]).sum(axis=1) + ahead[:, 3]
    return float(np.median(depth[np.isin(point, points)]) / np.median(depth))


@dataclass(frozen=True)
class _Test:
    """Pairs of points, and for each point one picture that observes it."""

    before: Float64[np.ndarray, "k 3"]
    after: Float64[np.ndarray, "k 3"]
    seen_before: Float64[np.ndarray, "k 3 4"]
    """Projection into the picture, in units of its longer side."""
    seen_after: Float64[np.ndarray, "k 3 4"]

    @staticmethod
    def of(before: SparseModel, after: SparseModel, pairs: Int64[np.ndarray, "k 2"]) -> "_Test":
        xyz, projections = [], []
        for model, chosen in ((before, pairs[:, 0]), (after, pairs[:, 1])):
            point, picture = model.points.observations.T
            witness = np.zeros(len(model.points.xyz), np.int64)
            witness[point] = picture
            xyz.append(model.points.xyz[chosen])
            projections.append(_projections(model)[witness[chosen]])
        return _Test(*xyz, *projections)

    def follows(
        self, motions: Float64[np.ndarray, "m 4 4"], slack: float = 1.0
    ) -> Bool[np.ndarray, "m k"]:
        """Whether each pair falls onto each other in both pictures, under each motion."""
        there = _seen(_carried(self.before, motions), self.seen_after)
        here = _seen(_carried(self.after, np.linalg.inv(motions)), self.seen_before)
        apart = np.maximum(
            np.linalg.norm(there - _seen(self.after[None], self.seen_after), axis=-1),
            np.linalg.norm(here - _seen(self.before[None], self.seen_before), axis=-1),
        )
        return apart < slack * TOLERANCE


def _strongest(
    test: _Test, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "4 4"], Bool[np.ndarray, "k"]]:
    """The motion that most pairs follow, and which they are."""
    motion, best = np.eye(4), np.zeros(len(test.before), bool)
    if len(best) < MIN_PAIRS:
        return motion, best
    for chosen in _triples(test, rng):
        motions = np.stack([_similarity(test.before[t], test.after[t]) for t in chosen])
        agree = test.follows(motions)
        top = int(agree.sum(axis=1).argmax())
        if agree[top].sum() > best.sum():
            motion, best = motions[top], agree[top]
    for _ in range(4):
        if best.sum() < MIN_PAIRS:
            break
        refined = _similarity(test.before[best], test.after[best])
        agree = test.follows(refined[None])[0]
        if agree.sum() <= best.sum():
            break
        motion, best = refined, agree
    return motion, best


def _triples(test: _Test, rng: np.random.Generator) -> Iterable[Int64[np.ndarray, "c 3"]]:
    """Three pairs each, in chunks: triangles that a similarity may carry into each other."""
    drawn = rng.integers(0, len(test.before), (_TRIALS, 3))
    a, b = (
        np.linalg.norm(x[drawn] - x[np.roll(drawn, 1, axis=1)], axis=2)
        for x in (test.before, test.after)
    )
    size = np.median(np.linalg.norm(test.before - np.median(test.before, axis=0), axis=1))
    wide = (a > _WIDE * size).all(axis=1) & (b > 0).all(axis=1)
    ratio = b[wide] / a[wide]
    fits = ratio.max(axis=1) <= (1 + _STRETCH) * ratio.min(axis=1)
    kept = drawn[wide][fits][:_KEPT]
    return [kept[start : start + _CHUNK] for start in range(0, len(kept), _CHUNK)]


def _similarity(
    before: Float64[np.ndarray, "k 3"], after: Float64[np.ndarray, "k 3"]
) -> Float64[np.ndarray, "4 4"]:
    """Least-squares similarity of points (Umeyama 1991)."""
    middle, target = before.mean(axis=0), after.mean(axis=0)
    a, b = before - middle, after - target
    u, d, vt = np.linalg.svd(b.T @ a)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    turn = (u * signs @ vt) * float(d @ signs / max((a**2).sum(), 1e-300))
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn, target - turn @ middle
    return motion


def _carried(
    xyz: Float64[np.ndarray, "k 3"], motions: Float64[np.ndarray, "*m 4 4"]
) -> Float64[np.ndarray, "*m k 3"]:
    turned = xyz @ np.swapaxes(motions[..., :3, :3], -1, -2)
    return turned + motions[..., None, :3, 3]


def _projections(model: SparseModel) -> Float64[np.ndarray, "n 3 4"]:
    """Of each picture, without distortion, in units of its longer side."""
    return np.array([_projection(picture) for picture in model.pictures]).reshape(-1, 3, 4)


def _projection(picture: PosedPicture) -> Float64[np.ndarray, "3 4"]:
    side = max(picture.lens.width, picture.lens.height)
    return np.diag([1 / side, 1 / side, 1]) @ picture.lens.intrinsics @ picture.cam_from_world[:3]


def _seen(
    xyz: Float64[np.ndarray, "m k 3"], projections: Float64[np.ndarray, "k 3 4"]
) -> Float64[np.ndarray, "m k 2"]:
    image = np.einsum("kij,mkj->mki", projections[..., :3], xyz) + projections[..., 3]
    depth = np.where(image[..., 2:] > 0, image[..., 2:], np.nan)
    return image[..., :2] / depth
