"""Triangle soups with normals and texture coordinates, and the shapes all objects are made of.

World axes: metres, z up. Every solid stands on z = 0 at the origin until it is moved.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles by their corners; nothing is shared between triangles."""

    points: Float32[np.ndarray, "t 3 3"]
    """Corner positions in metres."""
    normals: Float32[np.ndarray, "t 3 3"]
    """Unit shading normals at the corners."""
    uv: Float32[np.ndarray, "t 3 2"]
    """Texture coordinates: 0 to 1 spans the picture once; v runs upwards."""

    def moved(
        self, offset: Sequence[float] = (0, 0, 0), yaw: float = 0.0, tilt: float = 0.0
    ) -> "Mesh":
        """Turned by `tilt` about x, then by `yaw` about z (radians), then shifted (metres)."""
        c, s = np.cos(yaw), np.sin(yaw)
        ct, st = np.cos(tilt), np.sin(tilt)
        about_x = np.array([[1, 0, 0], [0, ct, -st], [0, st, ct]])
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ about_x
        points = _rotate(self.points, turn) + np.asarray(offset, np.float32)
        return Mesh(points.astype(np.float32), _rotate(self.normals, turn), self.uv)

    def stretched(self, x: float, y: float, z: float) -> "Mesh":
        """Scaled along the axes about the origin."""
        normals = self.normals / np.array([x, y, z], np.float32)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        scale = np.array([x, y, z], np.float32)
        return Mesh(self.points * scale, normals.astype(np.float32), self.uv)

    def tiled(self, repeat_u: float, repeat_v: float) -> "Mesh":
        """With the texture repeated that often."""
        return Mesh(self.points, self.normals, self.uv * np.array([repeat_u, repeat_v], np.float32))


def join(meshes: Sequence[Mesh]) -> Mesh:
    """All triangles in one mesh."""
    return Mesh(
        np.concatenate([m.points for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.uv for m in meshes]),
    )


def grid(points: np.ndarray, normals: np.ndarray, u: np.ndarray, v: np.ndarray) -> Mesh:
    """Two triangles for every cell of an (m, n) grid of points; drops triangles without area.

    Parameters
    ----------
    points, normals : array (m, n, 3)
    u : array (n,)
        Texture coordinate along the second axis.
    v : array (m,)
        Texture coordinate along the first axis.
    """
    uv = np.stack(np.meshgrid(u, v), axis=-1)

    def corners(values: np.ndarray) -> np.ndarray:
        a, b = values[:-1, :-1], values[:-1, 1:]
        c, d = values[1:, 1:], values[1:, :-1]
        faces = np.stack([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)], axis=2)
        return faces.reshape(-1, 3, values.shape[-1]).astype(np.float32)

    soup = corners(points)
    area = np.linalg.norm(np.cross(soup[:, 1] - soup[:, 0], soup[:, 2] - soup[:, 0]), axis=-1)
    keep = area > 1e-10
    return Mesh(soup[keep], corners(normals)[keep], corners(uv)[keep])


def quad(origin: Sequence[float], edge_u: Sequence[float], edge_v: Sequence[float]) -> Mesh:
    """A flat rectangle; its normal is ``edge_u x edge_v``."""
    o, u, v = (np.asarray(a, np.float64) for a in (origin, edge_u, edge_v))
    normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
    points = np.array([[o, o + u], [o + v, o + u + v]])
    ends = np.array([0.0, 1.0])
    return grid(points, np.broadcast_to(normal, points.shape), ends, ends)


def box(x: float, y: float, z: float) -> Mesh:
    """A cuboid; every face shows the whole texture once."""
    return join([box_sides(x, y, z), box_front_back(x, y, z), box_lids(x, y, z)])


def box_front_back(x: float, y: float, z: float) -> Mesh:
    """The two faces of `box` across the y axis."""
    front = quad((-x / 2, -y / 2, 0), (x, 0, 0), (0, 0, z))
    return join([front, quad((x / 2, y / 2, 0), (-x, 0, 0), (0, 0, z))])


def box_sides(x: float, y: float, z: float) -> Mesh:
    """The two faces of `box` across the x axis."""
    right = quad((x / 2, -y / 2, 0), (0, y, 0), (0, 0, z))
    return join([right, quad((-x / 2, y / 2, 0), (0, -y, 0), (0, 0, z))])


def box_lids(x: float, y: float, z: float) -> Mesh:
    """The top and bottom faces of `box`."""
    top = quad((-x / 2, -y / 2, z), (x, 0, 0), (0, y, 0))
    return join([top, quad((x / 2, -y / 2, 0), (-x, 0, 0), (0, y, 0))])


def lathe(
    profile: Sequence[tuple[float, float]], segments: int = 40, *, smooth: bool = False
) -> Mesh:
    """A profile of (radius, height) turned about the z axis.

    The texture goes once round, and up along the length of the profile. List the profile from
    the bottom upwards along the outside, so that normals point outwards.
    """
    rz = np.asarray(profile, np.float64)
    step = np.diff(rz, axis=0)
    length = np.linalg.norm(step, axis=1)
    flat = np.stack([step[:, 1], -step[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
    along = np.r_[0.0, np.cumsum(length)] / length.sum()
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    if smooth:
        joint = np.concatenate([flat[:1], flat[:-1] + flat[1:], flat[-1:]])
        joint /= np.maximum(np.linalg.norm(joint, axis=1), 1e-9)[:, None]
        return grid(_turned(rz, ring), _turned(joint, ring), angle / (2 * np.pi), along)
    bands = []
    for k, normal in enumerate(flat):
        pair = np.stack([normal, normal])
        bands.append(
            grid(
                _turned(rz[k : k + 2], ring),
                _turned(pair, ring),
                angle / (2 * np.pi),
                along[k : k + 2],
            )
        )
    return join(bands)


def cylinder(radius: float, height: float, segments: int = 40) -> Mesh:
    """The wall of a cylinder; the texture goes round once."""
    return lathe([(radius, 0.0), (radius, height)], segments)


def disc(radius: float, z: float, segments: int = 40) -> Mesh:
    """A flat disc that faces upwards, textured like a picture seen from above."""
    flat = lathe([(radius, z), (0.0, z)], segments)
    return Mesh(flat.points, flat.normals, flat.points[..., :2] / (2 * radius) + 0.5)


def sphere(radius: float, segments: int = 40) -> Mesh:
    """A ball that touches z = 0."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
    radii = np.maximum(radius * np.cos(angle), 0.0)
    return lathe(
        list(zip(radii, radius + radius * np.sin(angle), strict=True)), segments, smooth=True
    )


def tube(path: np.ndarray, radius: float, segments: int = 12) -> Mesh:
    """A round bar along a path of (k, 3) points that lies in one plane or nearly so."""
    path = np.asarray(path, np.float64)
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    spread = path - path.mean(axis=0)
    plane = np.cross(spread[0], tangent[len(path) // 2])
    if np.linalg.norm(plane) < 1e-9:  # a straight bar: any direction across it will do
        plane = np.cross(tangent[0], np.eye(3)[np.argmin(np.abs(tangent[0]))])
    side = plane / np.linalg.norm(plane)
    other = np.cross(tangent, side)
    other /= np.linalg.norm(other, axis=1, keepdims=True)
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    normal = np.cos(angle)[None, :, None] * side + np.sin(angle)[None, :, None] * other[:, None, :]
    points = path[:, None] + radius * normal
    return grid(points, normal, angle / (2 * np.pi), np.linspace(0, 1, len(path)))


def arc(radius_x: float, radius_z: float, start: float, end: float, count: int = 14) -> np.ndarray:
    """Points (count, 3) along an ellipse about the origin in the x-z plane; angles in radians."""
    a = np.linspace(start, end, count)
    return np.stack([radius_x * np.cos(a), np.zeros_like(a), radius_z * np.sin(a)], axis=-1)


def sheet(width: float, height: float, depth: float, folds: int, segments: int = 96) -> Mesh:
    """A hanging cloth in the x-z plane with `folds` waves of the given depth."""
    s = np.linspace(0, 1, segments + 1)
    x, y = (s - 0.5) * width, depth * np.sin(2 * np.pi * folds * s)
    slope = depth * 2 * np.pi * folds * np.cos(2 * np.pi * folds * s) / width
    normal = np.stack([slope, -np.ones_like(s), np.zeros_like(s)], axis=-1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rows = [np.stack([x, y, np.full_like(x, z)], axis=-1) for z in (0.0, height)]
    return grid(np.stack(rows), np.stack([normal, normal]), s, np.array([0.0, 1.0]))


def _turned(rz: np.ndarray, ring: np.ndarray) -> np.ndarray:
    xy = rz[:, None, :1] * ring[None]
    z = np.broadcast_to(rz[:, None, 1:], (*xy.shape[:2], 1))
    return np.concatenate([xy, z], axis=-1)


def _rotate(values: np.ndarray, turn: np.ndarray) -> np.ndarray:
    # A sum written out: the result does not depend on a BLAS library's order.
    x, y, z = values[..., 0, None], values[..., 1, None], values[..., 2, None]
    return (x * turn[:, 0] + y * turn[:, 1] + z * turn[:, 2]).astype(np.float32)
