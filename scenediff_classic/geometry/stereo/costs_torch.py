"""What a plane costs, in PyTorch: for many pixels, and as many planes, at once.

Every function stands for the one of the same name in `kernels_reference`, which is the one to
read. Shapes: ``p`` pixels, ``n`` sources of each, ``k`` samples of a window.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float32, Int64
from torch import Tensor

from scenediff_classic.geometry.stereo.kernels import MIN_VARIANCE, UNSEEN, Rules
from scenediff_classic.geometry.stereo.pyramid import Pictures

UNSEEN_COST = float(UNSEEN)
TEXTURE = float(MIN_VARIANCE)


class LoadedPictures(NamedTuple):
    """`Pictures` on a device."""

    reference: Tensor
    sources: Tensor
    sizes: Tensor
    warps: Tensor
    depths: Tensor
    returns: Tensor
    camera: Tensor


class LoadedWindows(NamedTuple):
    """`Windows` on a device."""

    weights: Float32[Tensor, "h w k"]
    weighted: Float32[Tensor, "h w k"]
    variance: Float32[Tensor, "h w"]
    dx: Float32[Tensor, "k"]
    dy: Float32[Tensor, "k"]


class Patches(NamedTuple):
    """Some pixels of the reference picture, and their windows."""

    index: Int64[Tensor, "p"]
    """Row-major."""
    row: Int64[Tensor, "p"]
    col: Int64[Tensor, "p"]
    x: Float32[Tensor, "p"]
    y: Float32[Tensor, "p"]
    grey: Float32[Tensor, "p"]
    weights: Float32[Tensor, "p k"]
    weighted: Float32[Tensor, "p k"]
    variance: Float32[Tensor, "p"]
    dx: Float32[Tensor, "k"]
    dy: Float32[Tensor, "k"]


class PlainRules(NamedTuple):
    """`Rules` in Python's numbers; NumPy's would draw tensors back to the CPU."""

    radius: int
    best: int
    w_min: float
    w_max: float
    min_cosine: float
    cap: float
    consistency: float
    tolerance: float
    parallax: float

    @staticmethod
    def of(rules: Rules) -> "PlainRules":
        """The same rules."""
        return PlainRules(*(np.asarray(rule).item() for rule in rules))


def load(pictures: Pictures, device: str) -> LoadedPictures:
    """The pictures on a device."""
    return LoadedPictures(*(torch.tensor(array, device=device) for array in pictures))


def patches_at(
    index: Int64[Tensor, "p"], pictures: LoadedPictures, windows: LoadedWindows
) -> Patches:
    """Pixels, given by their row-major index, and their windows."""
    width = pictures.reference.shape[1]
    row, col = index // width, index % width
    return Patches(
        index, row, col, col + 0.5, row + 0.5, pictures.reference[row, col],
        windows.weights[row, col], windows.weighted[row, col], windows.variance[row, col],
        windows.dx, windows.dy,
    )  # fmt: skip


def rank_sources(
    pictures: LoadedPictures, rules: PlainRules, patches: Patches, planes: Float32[Tensor, "p 3"]
) -> tuple[Int64[Tensor, "p best"], Float32[Tensor, "p"]]:
    """The sources that a plane costs least in, the best one first, and the mean cost in them."""
    sources = torch.arange(len(pictures.sources), device=planes.device).expand(len(planes), -1)
    costs, order = cost_in(sources, pictures, rules, patches, planes).sort(dim=1, stable=True)
    return order[:, : rules.best], costs[:, : rules.best].mean(dim=1)


def cost_in(
    sources: Int64[Tensor, "p n"],
    pictures: LoadedPictures,
    rules: PlainRules,
    patches: Patches,
    planes: Float32[Tensor, "p 3"],
) -> Float32[Tensor, "p n"]:
    """Cost of a plane in sources: how unlike it looks there, and what their depth there says."""
    home = torch.stack([patches.x, patches.y, torch.ones_like(patches.x), planes[:, 0]], dim=1)
    warps = pictures.warps[sources]
    position = (warps * home[:, None, None]).sum(dim=3)
    unlikeness = source_cost(sources, pictures, rules, patches, planes, warps, position)
    cost = unlikeness.clamp(max=rules.cap)
    cost = torch.where(patches.variance[:, None] > TEXTURE, cost, rules.cap)
    if rules.consistency > 0:
        contradicted = disagreement(sources, pictures, rules, patches, position)
        cost = cost + rules.consistency * contradicted
    return cost


def source_cost(
    sources: Int64[Tensor, "p n"],
    pictures: LoadedPictures,
    rules: PlainRules,
    patches: Patches,
    planes: Float32[Tensor, "p 3"],
    warps: Float32[Tensor, "p n 3 4"],
    position: Float32[Tensor, "p n 3"],
) -> Float32[Tensor, "p n"]:
    """1 - bilaterally weighted NCC of the pixels' windows, under a plane, in sources.

    `position` is where the pixels come to lie in the sources, in homogeneous coordinates.
    """
    z = position[..., 2]
    slopes = warps[..., :2] + warps[..., 3:] * planes[:, None, None, 1:]
    ahead = z - rules.radius * slopes[..., 2, :].abs().sum(dim=2) > 0
    uv = position[..., :2] / z[..., None]
    jacobian = (slopes[..., :2, :] - uv[..., None] * slopes[..., 2:, :]) / z[..., None, None]
    u, v = (
        uv[..., i, None] - 0.5
        + jacobian[..., i, 0, None] * patches.dx + jacobian[..., i, 1, None] * patches.dy
        for i in (0, 1)
    )  # fmt: skip
    values = bilinear(pictures, sources, u, v) - patches.grey[:, None, None]
    mean = (patches.weights[:, None] * values).sum(dim=2)
    spread = (patches.weights[:, None] * values * values).sum(dim=2) - mean * mean
    product = (patches.weighted[:, None] * values).sum(dim=2)
    cost = 1 - product / (spread * patches.variance[:, None]).sqrt()
    # any comparison with NaN (ignored samples) is False
    seen = ahead & _inside(pictures, sources, uv) & (spread > TEXTURE) & (cost < UNSEEN_COST)
    return torch.where(seen, cost, UNSEEN_COST)


def bilinear(
    pictures: LoadedPictures,
    sources: Int64[Tensor, "p n"],
    u: Float32[Tensor, "p n k"],
    v: Float32[Tensor, "p n k"],
) -> Float32[Tensor, "p n k"]:
    """Grey at array coordinates (column u, row v) of sources, held constant beyond their rim."""
    _, rows, columns = pictures.sources.shape
    last_v, last_u = (pictures.sizes[sources] - 1.0)[:, :, None].unbind(dim=3)
    u = torch.where(u > 0, u, 0.0).minimum(last_u)  # a NaN becomes 0: no index leaves the picture
    v = torch.where(v > 0, v, 0.0).minimum(last_v)
    left, top = u.long(), v.long()
    fu, fv = u - left, v - top
    index = (sources[:, :, None] * rows + top) * columns + left
    grey = pictures.sources.flatten()
    upper, lower = grey[index], grey[index + columns]
    upper = upper + fu * (grey[index + 1] - upper)
    lower = lower + fu * (grey[index + columns + 1] - lower)
    return upper + fv * (lower - upper)


def disagreement(
    sources: Int64[Tensor, "p n"],
    pictures: LoadedPictures,
    rules: PlainRules,
    patches: Patches,
    position: Float32[Tensor, "p n 3"],
) -> Float32[Tensor, "p n"]:
    """Forward-backward error of a depth against sources' own ones, as a share of tolerance."""
    _, rows, columns = pictures.depths.shape
    uv = position[..., :2] / position[..., 2:]
    inside = _inside(pictures, sources, uv)
    col, row = torch.where(inside[..., None], uv, 0.0).long().unbind(dim=2)
    found = pictures.depths.flatten()[(sources * rows + row) * columns + col]
    there = torch.stack([uv[..., 0], uv[..., 1], torch.ones_like(found), found], dim=2)
    back = (pictures.returns[sources] * there[:, :, None]).sum(dim=3)
    dx = back[..., 0] / back[..., 2] - patches.x[:, None]
    dy = back[..., 1] / back[..., 2] - patches.y[:, None]
    error = (dx * dx + dy * dy).sqrt() / rules.tolerance
    return torch.where(inside & (found > 0) & (error < 1), error, 1.0)


def allowed(
    pictures: LoadedPictures, rules: PlainRules, patches: Patches, planes: Float32[Tensor, "p 3"]
) -> Bool[Tensor, "p"]:
    """True for planes inside the depth range that are not seen too edge-on."""
    fx, fy, cx, cy = pictures.camera
    w, gx, gy = planes.unbind(dim=1)
    ray_x, ray_y = (patches.x - cx) / fx, (patches.y - cy) / fy
    nx, ny = gx * fx, gy * fy
    nz = w - nx * ray_x - ny * ray_y
    lengths = (nx * nx + ny * ny + nz * nz) * (ray_x * ray_x + ray_y * ray_y + 1)
    upright = w * w >= rules.min_cosine**2 * lengths
    return (w >= rules.w_min) & (w <= rules.w_max) & upright


def _inside(
    pictures: LoadedPictures, sources: Int64[Tensor, "p n"], uv: Float32[Tensor, "p n 2"]
) -> Bool[Tensor, "p n"]:
    return ((uv >= 0) & (uv < pictures.sizes[sources].flip(2))).all(dim=2)
