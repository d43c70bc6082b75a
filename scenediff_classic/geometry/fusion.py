"""One coloured point cloud of all measured depth."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, Int64, UInt8

from scenediff_classic.cameras import unproject
from scenediff_classic.types import Geometry
from scenediff_classic.workspace import write_atomic

VOXELS_ACROSS = 400
"""Default resolution: this many voxels along the scene's longest side."""


@dataclass(frozen=True)
class ColouredCloud:
    """Surface points in the geometry's world."""

    xyz: Float32[np.ndarray, "n 3"]
    rgb: UInt8[np.ndarray, "n 3"]


def fuse(geometry: Geometry, voxel: float | None = None) -> ColouredCloud:
    """Merge the measured depth of all views: one mean point and colour per occupied voxel.

    Parameters
    ----------
    voxel : float, optional
        Edge length in world units; by default 1 / `VOXELS_ACROSS` of the scene's extent (1 to 99
        percentile, longest side). Completed depth is a guess and is left out.
    """
    xyz = np.concatenate([unproject(v)[v.measured] for v in geometry.views] or [np.zeros((0, 3))])
    rgb = np.concatenate(
        [v.image[v.measured] for v in geometry.views] or [np.zeros((0, 3), np.uint8)]
    )
    if not len(xyz):
        return ColouredCloud(xyz.astype(np.float32), rgb)
    xyz = xyz.astype(np.float64)
    if voxel is None:
        low, high = np.percentile(xyz, [1, 99], axis=0)
        voxel = float(np.max(high - low)) / VOXELS_ACROSS
    cell, count = _cells(xyz, max(voxel, np.finfo(np.float64).tiny))
    return ColouredCloud(
        _means(cell, count, xyz).astype(np.float32),
        np.rint(_means(cell, count, rgb.astype(np.float64))).astype(np.uint8),
    )


def write_ply(path: Path, cloud: ColouredCloud) -> None:
    """Write a binary PLY that common viewers open; the file appears complete or not at all.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    layout = np.dtype(
        [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    )
    vertices = np.empty(len(cloud.xyz), layout)
    for i, name in enumerate(("x", "y", "z")):
        vertices[name] = cloud.xyz[:, i]
    for i, name in enumerate(("red", "green", "blue")):
        vertices[name] = cloud.rgb[:, i]
    kinds = ["float"] * 3 + ["uchar"] * 3
    properties = [f"property {k} {n}" for k, n in zip(kinds, layout.names or (), strict=True)]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    text = "\n".join([*header, *properties, "end_header", ""])
    write_atomic(path, text.encode("ascii") + vertices.tobytes())


def _cells(
    xyz: Float64[np.ndarray, "n 3"], voxel: float
) -> tuple[Int64[np.ndarray, "n"], Int64[np.ndarray, "cells"]]:
    """Number of the voxel that holds each point, and how many points each voxel holds."""
    index = np.floor(xyz / voxel).astype(np.int64)
    index -= index.min(axis=0)
    size = index.max(axis=0) + 1
    flat = (index[:, 0] * size[1] + index[:, 1]) * size[2] + index[:, 2]
    _, cell, count = np.unique(flat, return_inverse=True, return_counts=True)
    return cell, count


def _means(
    cell: Int64[np.ndarray, "n"], count: Int64[np.ndarray, "cells"], values: np.ndarray
) -> Float64[np.ndarray, "cells 3"]:
    """Mean of the values (n, 3) in each voxel."""
    sums = [np.bincount(cell, values[:, i], len(count)) for i in range(3)]
    return np.stack(sums, axis=1) / count[:, None]
