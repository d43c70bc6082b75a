"""Rays against a scene, by Open3D's `RaycastingScene`: what they hit, and whether they are free."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import open3d as o3d
from jaxtyping import Bool, Float32, Float64, Int64, UInt16

from data_tools.synthetic_pairs.meshes import join
from data_tools.synthetic_pairs.models import Model
from scenediff_classic.cameras import camera_centre


@dataclass(frozen=True)
class Camera:
    """A pinhole camera at a place (conventions as in `scenediff_classic.types`)."""

    width: int
    height: int
    intrinsics: Float64[np.ndarray, "3 3"]
    cam_from_world: Float64[np.ndarray, "4 4"]

    def rays(self) -> Float32[np.ndarray, "n 6"]:
        """Rays through the centres of all pixels, row by row."""
        y, x = np.divmod(np.arange(self.height * self.width), self.width)
        return self.rays_at(x + 0.5, y + 0.5)

    def rays_at(
        self, x: Float64[np.ndarray, "n"], y: Float64[np.ndarray, "n"]
    ) -> Float32[np.ndarray, "n 6"]:
        """Origin and direction through continuous positions on the picture.

        One unit along a ray is one unit of z-depth.
        """
        right, down, ahead = self.cam_from_world[:3, :3].astype(np.float32)
        u = ((x - self.intrinsics[0, 2]) / self.intrinsics[0, 0]).astype(np.float32)
        v = ((y - self.intrinsics[1, 2]) / self.intrinsics[1, 1]).astype(np.float32)
        rays = np.empty((len(x), 6), np.float32)
        rays[:, :3] = camera_centre(self.cam_from_world)
        rays[:, 3:] = u[:, None] * right + v[:, None] * down + ahead
        return rays


@dataclass(frozen=True)
class Hits:
    """Where rays meet the scene; one row a ray."""

    seen: Bool[np.ndarray, "n"]
    depth: Float32[np.ndarray, "n"]
    part: Int64[np.ndarray, "n"]
    """Number of the part (one mesh of one thing)."""
    material: Int64[np.ndarray, "n"]
    """Position in `Tracer.materials`."""
    instance: UInt16[np.ndarray, "n"]
    density: Float32[np.ndarray, "n"]
    """Texture coordinates per metre on the surface."""
    position: Float32[np.ndarray, "n 3"]
    normal: Float32[np.ndarray, "n 3"]
    """Shading normal, towards the viewer."""
    facing: Float32[np.ndarray, "n 3"]
    """Normal of the flat triangle, towards the viewer."""
    uv: Float32[np.ndarray, "n 2"]
    toward: Float32[np.ndarray, "n 3"]
    """Unit vector to the viewer."""

    def take(self, rows: Int64[np.ndarray, "m"]) -> "Hits":
        """Some of the rays."""
        return Hits(*(getattr(self, field.name)[rows] for field in fields(self)))


class Tracer:
    """The triangles of all things in place.

    Parameters
    ----------
    things : sequence of (id, Model)
        The models in place; 0 is the id of what counts as no object.
    """

    def __init__(self, things: Sequence[tuple[int, Model]]) -> None:
        parts = [(identity, part) for identity, model in things for part in model.parts]
        self.mesh = join([part.mesh for _, part in parts])
        self.materials = list({id(part.material): part.material for _, part in parts}.values())
        position = {id(material): k for k, material in enumerate(self.materials)}
        counts = [len(part.mesh.points) for _, part in parts]
        self._instance = np.repeat([identity for identity, _ in parts], counts).astype(np.uint16)
        self._material = np.repeat([position[id(part.material)] for _, part in parts], counts)
        self._part = np.repeat(np.arange(len(parts)), counts)
        self._density = _texture_density(self.mesh.points, self.mesh.uv)
        corners = self.mesh.points.reshape(-1, 3)
        order = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor.from_numpy(corners), o3d.core.Tensor.from_numpy(order)
        )

    def identify(self, camera: Camera) -> UInt16[np.ndarray, "h w"]:
        """Instance ids alone, at a third of the cost of `cast`."""
        _, seen, triangle = self._first(camera.rays())
        return self._instances(seen, triangle).reshape(camera.height, camera.width)

    def _first(
        self, rays: Float32[np.ndarray, "n 6"]
    ) -> tuple[dict[str, o3d.core.Tensor], Bool[np.ndarray, "n"], Int64[np.ndarray, "n"]]:
        """What Open3D says of each ray, whether it hits anything, and which triangle (else 0)."""
        found = self._scene.cast_rays(o3d.core.Tensor.from_numpy(np.ascontiguousarray(rays)))
        seen = np.isfinite(found["t_hit"].numpy())
        return found, seen, np.where(seen, found["primitive_ids"].numpy().astype(np.int64), 0)

    def _instances(
        self, seen: Bool[np.ndarray, "n"], triangle: Int64[np.ndarray, "n"]
    ) -> UInt16[np.ndarray, "n"]:
        return np.where(seen, self._instance[triangle], 0).astype(np.uint16)

    def cast(self, rays: Float32[np.ndarray, "n 6"]) -> Hits:
        """The first surface along each ray."""
        found, seen, triangle = self._first(rays)
        depth = found["t_hit"].numpy()
        b, c = found["primitive_uvs"].numpy().T[..., None]
        direction = rays[:, 3:]
        toward = -unit(direction)

        def interpolate(values: np.ndarray) -> np.ndarray:
            corner = values[triangle]
            return corner[:, 0] * (1 - b - c) + corner[:, 1] * b + corner[:, 2] * c

        return Hits(
            seen=seen,
            depth=depth,
            part=self._part[triangle],
            material=self._material[triangle],
            instance=self._instances(seen, triangle),
            density=self._density[triangle],
            position=rays[:, :3] + direction * np.where(seen, depth, 0)[:, None],
            normal=_turned_to(unit(interpolate(self.mesh.normals)), toward),
            facing=_turned_to(unit(found["primitive_normals"].numpy()), toward),
            uv=interpolate(self.mesh.uv),
            toward=toward,
        )

    def free(
        self,
        origin: Float32[np.ndarray, "n 3"],
        way: Float32[np.ndarray, "n 3"],
        wanted: Bool[np.ndarray, "n"],
    ) -> Bool[np.ndarray, "n"]:
        """True where nothing lies between a point and the end of its way; False if unwanted."""
        rows = np.flatnonzero(wanted)
        rays = np.empty((len(rows), 6), np.float32)
        rays[:, :3], rays[:, 3:] = origin[rows], way[rows]
        free = np.zeros(len(origin), bool)
        free[rows] = ~self._scene.test_occlusions(
            o3d.core.Tensor.from_numpy(rays), 0.0, 0.999
        ).numpy()
        return free


def same_surface(
    a: Hits, rows_a: Int64[np.ndarray, "n"], b: Hits, rows_b: Int64[np.ndarray, "n"]
) -> Bool[np.ndarray, "n"]:
    """Whether two hits lie on one smooth piece of the same part, for rows of `a` and `b`."""
    facing = a.facing[rows_a]
    near = np.abs(dot(a.position[rows_a] - b.position[rows_b], facing)) < 0.01 * a.depth[rows_a]
    return (a.part[rows_a] == b.part[rows_b]) & (dot(facing, b.facing[rows_b]) > 0.9) & near


def dot(a: Float32[np.ndarray, "n 3"], b: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n"]:
    """Row by row."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def unit(vectors: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
    """Scaled to length one."""
    return vectors / np.sqrt(np.maximum(dot(vectors, vectors), np.float32(1e-18)))[:, None]


def _texture_density(points: np.ndarray, uv: np.ndarray) -> np.ndarray:
    a, b = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    area = np.linalg.norm(np.cross(a, b), axis=1)
    c, d = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    on_texture = np.abs(c[:, 0] * d[:, 1] - c[:, 1] * d[:, 0])
    return np.sqrt(on_texture / np.maximum(area, 1e-12)).astype(np.float32)


def _turned_to(normal: np.ndarray, toward: np.ndarray) -> np.ndarray:
    return np.where((dot(normal, toward) < 0)[:, None], -normal, normal)
