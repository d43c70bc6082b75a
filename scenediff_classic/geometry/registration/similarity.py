"""The similarity that lays one model over another, from pairs of points that may be wrong."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from scenediff_classic.geometry.registration.sparse_model import PosedPicture, SparseModel

TOLERANCE = 0.006
"""Distance in the picture, as a share of its longer side, at which two points agree."""
MIN_PAIRS = 12
"""Pairs without which a motion is not told from chance."""
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
class PointPairs:
    """Pairs of points of two models, and for each point one picture that observes it.

    The models are called before and after: the first one is laid over the second.
    """

    before: Float64[np.ndarray, "k 3"]
    after: Float64[np.ndarray, "k 3"]
    seen_before: Float64[np.ndarray, "k 3 4"]
    """Projection into the picture, in units of its longer side."""
    seen_after: Float64[np.ndarray, "k 3 4"]

    @staticmethod
    def of(
        before: SparseModel, after: SparseModel, pairs: Int64[np.ndarray, "k 2"]
    ) -> "PointPairs":
        """Of the given (point before, point after)."""
        xyz, matrices = [], []
        for model, chosen in ((before, pairs[:, 0]), (after, pairs[:, 1])):
            point, picture = model.points.observations.T
            witness = np.zeros(len(model.points.xyz), np.int64)
            witness[point] = picture
            xyz.append(model.points.xyz[chosen])
            matrices.append(projection_matrices(model)[witness[chosen]])
        return PointPairs(*xyz, *matrices)

    def follows(
        self, motions: Float64[np.ndarray, "m 4 4"], slack: float = 1.0
    ) -> Bool[np.ndarray, "m k"]:
        """Whether each pair falls onto each other in both pictures, under each motion."""
        there = image_points(carried(self.before, motions), self.seen_after)
        here = image_points(carried(self.after, np.linalg.inv(motions)), self.seen_before)
        apart = np.maximum(
            np.linalg.norm(there - image_points(self.after[None], self.seen_after), axis=-1),
            np.linalg.norm(here - image_points(self.before[None], self.seen_before), axis=-1),
        )
        return apart < slack * TOLERANCE


def strongest(
    test: PointPairs, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "4 4"], Bool[np.ndarray, "k"]]:
    """The motion that most pairs follow, and which they are."""
    motion, best = np.eye(4), np.zeros(len(test.before), bool)
    if len(best) < MIN_PAIRS:
        return motion, best
    for chosen in _triples(test, rng):
        motions = np.stack([similarity(test.before[t], test.after[t]) for t in chosen])
        agree = test.follows(motions)
        top = int(agree.sum(axis=1).argmax())
        if agree[top].sum() > best.sum():
            motion, best = motions[top], agree[top]
    for _ in range(4):
        if best.sum() < MIN_PAIRS:
            break
        refined = similarity(test.before[best], test.after[best])
        agree = test.follows(refined[None])[0]
        if agree.sum() <= best.sum():
            break
        motion, best = refined, agree
    return motion, best


def _triples(test: PointPairs, rng: np.random.Generator) -> Iterable[Int64[np.ndarray, "c 3"]]:
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


def similarity(
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


def carried(
    xyz: Float64[np.ndarray, "k 3"], motions: Float64[np.ndarray, "*m 4 4"]
) -> Float64[np.ndarray, "*m k 3"]:
    """Points after each of the motions."""
    turned = xyz @ np.swapaxes(motions[..., :3, :3], -1, -2)
    return turned + motions[..., None, :3, 3]


def projection_matrices(model: SparseModel) -> Float64[np.ndarray, "n 3 4"]:
    """Of each picture, without distortion, in units of its longer side."""
    return np.array([_projection(picture) for picture in model.pictures]).reshape(-1, 3, 4)


def _projection(picture: PosedPicture) -> Float64[np.ndarray, "3 4"]:
    side = max(picture.lens.width, picture.lens.height)
    return np.diag([1 / side, 1 / side, 1]) @ picture.lens.intrinsics @ picture.cam_from_world[:3]


def image_points(
    xyz: Float64[np.ndarray, "m k 3"], matrices: Float64[np.ndarray, "k 3 4"]
) -> Float64[np.ndarray, "m k 2"]:
    """Where each point is in the picture of its matrix; NaN behind the camera."""
    image = np.einsum("kij,mkj->mki", matrices[..., :3], xyz) + matrices[..., 3]
    depth = np.where(image[..., 2:] > 0, image[..., 2:], np.nan)
    return image[..., :2] / depth
