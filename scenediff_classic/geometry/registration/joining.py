"""Two models made one: the first is carried into the world of the second."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64

from scenediff_classic.geometry.registration.similarity import carried
from scenediff_classic.geometry.registration.sparse_model import SparseModel
from scenediff_classic.types import SparsePoints


def join(
    moved: SparseModel,
    target: SparseModel,
    motion: Float64[np.ndarray, "4 4"],
    pairs: Int64[np.ndarray, "k 2"],
) -> SparseModel:
    """Both models in the world of the target; points that fall onto each other are one.

    A picture that is in both keeps its place in the target. Points that fewer than two pictures
    observe after that are dropped.

    Parameters
    ----------
    motion : array (4, 4)
        Similarity from the moved model's world to the target's.
    pairs : array (k, 2)
        (point of the moved model, point of the target) that are one; each point once at most.
    """
    held = {picture.name for picture in target.pictures}
    fresh = np.array([picture.name not in held for picture in moved.pictures], bool)
    names = [p.name for p in target.pictures]
    names += [p.name for p, new in zip(moved.pictures, fresh, strict=True) if new]
    place = {name: number for number, name in enumerate(sorted(names))}
    pictures = {p.name: p for p in target.pictures}
    scale = np.cbrt(np.linalg.det(motion[:3, :3]))
    turn, shift = motion[:3, :3] / scale, motion[:3, 3]
    for picture in (p for p in moved.pictures if p.name not in held):
        pose = np.eye(4)
        pose[:3, :3] = picture.cam_from_world[:3, :3] @ turn.T
        pose[:3, 3] = scale * picture.cam_from_world[:3, 3] - pose[:3, :3] @ shift
        pictures[picture.name] = replace(picture, cam_from_world=pose)

    count = len(target.points.xyz)
    number = count + np.arange(len(moved.points.xyz))
    number[pairs[:, 0]] = pairs[:, 1]
    xyz = np.concatenate([target.points.xyz, carried(moved.points.xyz, motion)])
    xyz[pairs[:, 1]] = (xyz[pairs[:, 1]] + xyz[count + pairs[:, 0]]) / 2
    rgb = np.concatenate([target.points.rgb, moved.points.rgb])

    kept = fresh[moved.points.observations[:, 1]]
    sides = ((target, target.points.observations), (moved, moved.points.observations[kept]))
    ranks = [np.array([place[p.name] for p in m.pictures], np.int64)[seen[:, 1]]
             for m, seen in sides]  # fmt: skip
    point = np.concatenate([sides[0][1][:, 0], number[sides[1][1][:, 0]]])
    enough = (np.bincount(point, minlength=len(xyz)) >= 2)[point]
    used, point = np.unique(point[enough], return_inverse=True)
    picture = np.concatenate(ranks)[enough]
    order = np.lexsort((picture, point))
    weights = [len(m.points.observations) for m, _ in sides]
    return SparseModel(
        tuple(pictures[name] for name in sorted(names)),
        SparsePoints(xyz[used], rgb[used], np.stack([point, picture], axis=1)[order]),
        float(np.average([m.error for m, _ in sides], weights=weights)),
        _both(target.keypoints, moved.keypoints, kept, enough, order),
        _both(target.features, moved.features, kept, enough, order),
    )


def _both(
    target: np.ndarray | None,
    moved: np.ndarray | None,
    kept: np.ndarray,
    enough: np.ndarray,
    order: np.ndarray,
) -> np.ndarray | None:
    """What is known of each observation, in the order of the joint model."""
    if target is None or moved is None:
        return None
    return np.concatenate([target, moved[kept]])[enough][order]
