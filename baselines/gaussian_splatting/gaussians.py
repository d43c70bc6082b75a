"""A scene as anisotropic 3D Gaussians (Kerbl et al., SIGGRAPH 2023).

The tensors hold what is optimised: logarithms of the scales, unnormalised quaternions, logits of
the opacities, coefficients of spherical harmonics.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Float, UInt8
from scipy.spatial import KDTree

from scenediff_classic.errors import InputError
from scenediff_classic.geometry.fusion import fuse
from scenediff_classic.types import Geometry

SH_0 = 0.28209479177387814
"""The spherical harmonic of degree 0: colour = 0.5 + SH_0 * its coefficient."""

MAX_DEGREE = 3
START_OPACITY = 0.1
START_OPACITY_DENSE = 0.5
"""On a fused depth cloud every point lies on a surface that it should cover."""


@dataclass(frozen=True)
class Points:
    """Coloured points to start from, in the world frame."""

    xyz: Float[np.ndarray, "n 3"]
    rgb: UInt8[np.ndarray, "n 3"]
    dense: bool = False
    """Whether they cover the surfaces (a fused depth cloud), or are sparse (from SfM)."""

    @staticmethod
    def of(geometry: Geometry, views: list[int] | None = None, most: int = 20_000) -> "Points":
        """The fused depth cloud of some views where there is one, otherwise the sparse points.

        Only measured depth counts: with completed depth as well, held-out pictures were no better
        and the rendered depth was worse.

        Parameters
        ----------
        views : list of int, optional
            Positions in `geometry.views`; all by default.
        most : int
            If there are more points, the cloud is made coarser until it has no more.

        Raises
        ------
        InputError
            If the geometry has neither depth nor points.
        """
        chosen = range(len(geometry.views)) if views is None else views
        part = Geometry(tuple(geometry.views[i] for i in chosen), geometry.points)
        if any(view.measured.any() for view in part.views):
            cloud = fuse(part)
            voxel = _extent(cloud.xyz) / 400
            while len(cloud.xyz) > most:
                voxel *= max(np.sqrt(len(cloud.xyz) / most), 1.02)
                cloud = fuse(part, voxel)
            return Points(cloud.xyz, cloud.rgb, dense=True)
        seen = geometry.points.observations
        rows = np.unique(seen[np.isin(seen[:, 1], list(chosen)), 0])
        if not len(rows):
            raise InputError("The geometry has neither depth nor points to start Gaussians from.")
        return Points(geometry.points.xyz[rows], geometry.points.rgb[rows])


@dataclass(frozen=True)
class Gaussians:
    """`n` Gaussians; all tensors share dtype and device."""

    means: Float[torch.Tensor, "n 3"]
    """Centres, in the world frame."""
    log_scales: Float[torch.Tensor, "n 3"]
    """Logarithm of the standard deviation along each axis, in world units."""
    quaternions: Float[torch.Tensor, "n 4"]
    """World from axes, as (w, x, y, z); need not be of unit length."""
    opacity_logits: Float[torch.Tensor, "n"]
    sh: Float[torch.Tensor, "n k 3"]
    """Colour by direction of view: (degree + 1) ** 2 coefficients a channel."""

    def __len__(self) -> int:
        """How many there are."""
        return len(self.means)

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return round(self.sh.shape[1] ** 0.5) - 1

    @property
    def opacities(self) -> Float[torch.Tensor, "n"]:
        """Opacity at the centre, 0 to 1."""
        return torch.sigmoid(self.opacity_logits)

    @property
    def rotations(self) -> Float[torch.Tensor, "n 3 3"]:
        """World from axes, as matrices."""
        return _rotation_matrices(self.quaternions)

    def colours(self, centre: Float[torch.Tensor, "3"], degree: int) -> Float[torch.Tensor, "n 3"]:
        """Red, green and blue, not negative, as seen from a camera at `centre`."""
        away = torch.nn.functional.normalize(self.means - centre, dim=1)
        basis = _harmonics(away, degree)
        mixed = torch.einsum("nk,nkc->nc", basis, self.sh[:, : basis.shape[1]])
        return (mixed + 0.5).clamp(min=0)

    def map(self, change: Callable[[torch.Tensor], torch.Tensor]) -> "Gaussians":
        """The same function applied to every tensor: a selection, a copy, another dtype."""
        return Gaussians(*(change(getattr(self, f.name)) for f in fields(self)))

    def detached(self) -> "Gaussians":
        """The same values without a graph."""
        return self.map(lambda t: t.detach())

    @staticmethod
    def start(
        points: Points, degree: int = MAX_DEGREE, dtype: torch.dtype = torch.float32
    ) -> "Gaussians":
        """A round Gaussian at each point, as large as the distance to its neighbours.

        Raises
        ------
        InputError
            If there are fewer than four points.
        """
        if len(points.xyz) < 4:
            raise InputError("Gaussians need at least four points to start from.")
        distance, _ = KDTree(points.xyz).query(points.xyz, k=4)
        spacing = np.sqrt(np.mean(distance[:, 1:] ** 2, axis=1))
        least = np.median(spacing) * 1e-2 + np.finfo(np.float32).tiny
        # sparse points miss most of the surface; isolated ones would else cover the picture
        spacing = np.clip(spacing, least, np.quantile(spacing, 0.99) if points.dense else None)
        if points.dense:
            spacing = spacing / 2
        opacity = START_OPACITY_DENSE if points.dense else START_OPACITY
        n = len(points.xyz)
        sh = np.zeros((n, (degree + 1) ** 2, 3))
        sh[:, 0] = (points.rgb / 255 - 0.5) / SH_0
        turn = np.tile([1.0, 0, 0, 0], (n, 1))
        logits = np.full(n, np.log(opacity / (1 - opacity)))
        scales = np.tile(np.log(spacing)[:, None], (1, 3))
        arrays = (points.xyz, scales, turn, logits, sh)
        return Gaussians(*(torch.tensor(np.asarray(a), dtype=dtype) for a in arrays))


def _extent(xyz: Float[np.ndarray, "n 3"]) -> float:
    low, high = np.percentile(xyz, [1, 99], axis=0)
    return float(np.max(high - low))


def _rotation_matrices(quaternions: Float[torch.Tensor, "n 4"]) -> Float[torch.Tensor, "n 3 3"]:
    """Rotation matrices of quaternions (w, x, y, z) of any length."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=1).unbind(1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, 1).reshape(-1, 3, 3)


def _harmonics(directions: Float[torch.Tensor, "n 3"], degree: int) -> Float[torch.Tensor, "n k"]:
    """Real spherical harmonics at unit vectors, in the order and with the signs of 3DGS."""
    x, y, z = directions.unbind(1)
    out = [torch.full_like(x, SH_0)]
    if degree > 0:
        k = 0.4886025119029199
        out += [-k * y, k * z, -k * x]
    if degree > 1:
        k = 1.0925484305920792
        out += [
            k * x * y, -k * y * z, 0.31539156525252005 * (2 * z * z - x * x - y * y),
            -k * x * z, k / 2 * (x * x - y * y),
        ]  # fmt: skip
    if degree > 2:
        a, b, c, d = 0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154
        out += [
            -a * y * (3 * x * x - y * y), b * x * y * z, -c * y * (4 * z * z - x * x - y * y),
            d * z * (2 * z * z - 3 * x * x - 3 * y * y), -c * x * (4 * z * z - x * x - y * y),
            b / 2 * z * (x * x - y * y), -a * x * (x * x - 3 * y * y),
        ]  # fmt: skip
    return torch.stack(out, 1)
