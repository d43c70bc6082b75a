"""Rendering Gaussians, differentiable by PyTorch: compiled kernels with a hand-written backward.

``render(gaussians, camera, extra=...) -> Rendering(rgb, depth, alpha, extra)`` draws everything in
one pass. Gradients reach the means, scales, rotations, opacities, colours, extra channels, and the
position on the picture (`screen_shift`). ``accumulate(gaussians, cameras, pictures)`` is the way
back without any optimisation: what the pixels say of each Gaussian.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import torch
from jaxtyping import Bool, Float

from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import Gaussians
from baselines.gaussian_splatting.projection_kernels import (
    HALF_WIDTH,
    MOMENTS,
    SPLAT,
    project,
    project_backward,
)
from baselines.gaussian_splatting.threads import GAUSSIANS, TILES, over_blocks
from baselines.gaussian_splatting.tile_kernels import (
    FIXED,
    TILE,
    composite,
    composite_backward,
    gather,
    list_tiles,
)

KNOWN_ALPHA = 0.5
"""Depth is known where at least this share of the light was stopped."""


@dataclass(frozen=True)
class Rendering:
    """One rendered view; differentiable where the Gaussians were."""

    rgb: Float[torch.Tensor, "h w 3"]
    """Colour, about 0 to 1, not clipped; black where nothing is."""
    depth_sum: Float[torch.Tensor, "h w"]
    """Sum of z-depth times weight."""
    alpha: Float[torch.Tensor, "h w"]
    """Share of the light that was stopped: the sum of the weights."""
    extra: Float[torch.Tensor, "h w e"]
    """Extra channels, weighted like colour: divide by `alpha` for their mean."""
    visible: Bool[torch.Tensor, "n"]
    """Which Gaussians are in sight."""

    @property
    def depth(self) -> Float[torch.Tensor, "h w"]:
        """Mean z-depth; NaN where less than half of the light was stopped."""
        unknown = torch.full_like(self.alpha, torch.nan)
        return torch.where(self.alpha > KNOWN_ALPHA, self.depth_sum / self.alpha, unknown)


def render(
    gaussians: Gaussians,
    camera: PinholeCamera,
    *,
    extra: Float[torch.Tensor, "n e"] | None = None,
    degree: int | None = None,
    screen_shift: Float[torch.Tensor, "n 2"] | None = None,
) -> Rendering:
    """Draw Gaussians: colour, depth, alpha and extra channels in one pass.

    Parameters
    ----------
    gaussians : Gaussians
        float32, or float64 (for checks); on the CPU, or on CUDA (float32, needs `gsplat`).
    extra : tensor, optional
        Any further values of each Gaussian.
    degree : int, optional
        Use spherical harmonics up to this degree only.
    screen_shift : tensor, optional
        Moves each splat on the picture, in pixels. Zeros that require a gradient tell how much
        the loss pulls at each Gaussian's position, which decides where more of them are needed.

    Raises
    ------
    InputError
        If the Gaussians are on a CUDA device and `gsplat` is not installed.
    """
    n = len(gaussians)
    extra = gaussians.means.new_zeros((n, 0)) if extra is None else extra
    shift = gaussians.means.new_zeros((n, 2)) if screen_shift is None else screen_shift
    degree = gaussians.degree if degree is None else min(degree, gaussians.degree)
    if gaussians.means.is_cuda:
        from baselines.gaussian_splatting.gsplat_backend import draw
    else:
        draw = _draw
    planes, visible = draw(gaussians, extra, shift, camera, degree)
    return Rendering(
        planes[:3].permute(1, 2, 0), planes[3], planes[-1], planes[4:-1].permute(1, 2, 0), visible
    )


def accumulate(
    gaussians: Gaussians,
    cameras: Sequence[PinholeCamera],
    pictures: Sequence[Float[np.ndarray, "h w c"]],
) -> tuple[Float[torch.Tensor, "n c"], Float[torch.Tensor, "n"]]:
    """Mean of what the pixels say of each Gaussian, in closed form: c_g = sum w M / sum w.

    The weight `w` of a Gaussian in a pixel is its alpha times the light that reaches it; sums run
    over the pixels of all views. One pass a view, no optimisation; always on the CPU.

    Parameters
    ----------
    pictures : sequence of arrays
        Values of each camera's pixels; NaN = unknown, which counts for nothing.

    Returns
    -------
    means : tensor (n, c)
        NaN for a Gaussian that no known pixel shows.
    weights : tensor (n,)
        Sum of the weights: how much of it was seen.
    """
    on_cpu = gaussians.map(lambda t: t.detach().cpu())
    channels = pictures[0].shape[2]
    dtype = on_cpu.means.numpy().dtype
    sums = np.zeros((len(on_cpu), 1 + channels))
    nothing, still = (on_cpu.means.new_zeros((len(on_cpu), k)) for k in (0, 2))
    for camera, picture in zip(cameras, pictures, strict=True):
        splats, _, lists = _project(on_cpu, nothing, still, camera, 0)
        known = np.isfinite(picture).all(axis=2, keepdims=True)
        planes = np.concatenate([known, np.where(known, picture, 0)], axis=2)
        planes = np.ascontiguousarray(planes.transpose(2, 0, 1), dtype=dtype)
        entries = np.empty((len(lists.gaussian), 2 + channels), dtype)
        arguments = (splats, lists.starts, lists.gaussian, planes, entries)
        over_blocks(gather, len(lists.starts) - 1, TILES, *arguments)
        for k in range(1 + channels):
            sums[:, k] += np.bincount(lists.gaussian, entries[:, 1 + k], len(on_cpu))
    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.where(sums[:, :1] > 0, sums[:, 1:] / sums[:, :1], np.nan)
    return torch.tensor(means.astype(dtype)), torch.tensor(sums[:, 0].astype(dtype))


@dataclass(frozen=True)
class _TileLists:
    """The splats of each tile, front to back (see `tile_kernels.list_tiles`)."""

    starts: np.ndarray
    gaussian: np.ndarray
    slots: np.ndarray
    slot_starts: np.ndarray


def _arrays(gaussians: Gaussians) -> tuple[np.ndarray, ...]:
    g = gaussians
    tensors = (g.means, g.log_scales, g.quaternions, g.opacity_logits, g.sh)
    return tuple(np.ascontiguousarray(t.detach().numpy()) for t in tensors)


def _project(
    gaussians: Gaussians,
    extra: torch.Tensor,
    shift: torch.Tensor,
    camera: PinholeCamera,
    degree: int,
) -> tuple[np.ndarray, np.ndarray, _TileLists]:
    arrays = _arrays(gaussians)
    dtype, n = arrays[0].dtype, len(gaussians)
    shape = (camera.height, camera.width)
    splats = np.empty((n, SPLAT), dtype)
    values = np.empty((n, FIXED + extra.shape[1]), dtype)
    more = (np.ascontiguousarray(t.detach().numpy()) for t in (extra, shift))
    packed = camera.packed(dtype.type)
    over_blocks(project, n, GAUSSIANS, *arrays, *more, packed, degree, shape, splats, values)
    seen = np.flatnonzero(splats[:, HALF_WIDTH])
    order = seen[np.argsort(values[seen, 3], kind="stable")]
    tiles = -(-shape[0] // TILE) * -(-shape[1] // TILE)
    counts, starts = np.empty(tiles, np.int32), np.empty(tiles + 1, np.int32)
    slot_starts, none = np.empty(n + 1, np.int32), np.empty(0, np.int32)
    list_tiles(splats, order, shape, counts, starts, slot_starts, none, none, False)
    gaussian, slots = np.empty(starts[-1], np.int32), np.empty(starts[-1], np.int32)
    list_tiles(splats, order, shape, counts, starts, slot_starts, gaussian, slots, True)
    return splats, values, _TileLists(starts, gaussian, slots, slot_starts)


def _draw(
    gaussians: Gaussians,
    extra: torch.Tensor,
    shift: torch.Tensor,
    camera: PinholeCamera,
    degree: int,
) -> tuple[torch.Tensor, torch.Tensor]:
    g = gaussians
    parameters = (g.means, g.log_scales, g.quaternions, g.opacity_logits, g.sh)
    answer = _Splatting.apply(*parameters, extra, shift, camera, degree)
    return cast(tuple[torch.Tensor, torch.Tensor], answer)


class _Splatting(torch.autograd.Function):
    """Planes (channels + 1, h, w) and the Gaussians in sight."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> tuple[torch.Tensor, torch.Tensor]:
        gaussians, (extra, shift, camera, degree) = Gaussians(*inputs[:5]), inputs[5:]
        splats, values, lists = _project(gaussians, extra, shift, camera, degree)
        planes = np.empty((values.shape[1] + 1, camera.height, camera.width), splats.dtype)
        arguments = (splats, values, lists.starts, lists.gaussian, planes)
        over_blocks(composite, len(lists.starts) - 1, TILES, *arguments)
        answer, visible = torch.from_numpy(planes), torch.from_numpy(splats[:, HALF_WIDTH] > 0)
        ctx.save_for_backward(*inputs[:5], answer)
        ctx.kept = (splats, values, lists, camera, degree)
        ctx.mark_non_differentiable(visible)
        return answer, visible

    @staticmethod
    def backward(ctx: Any, *grads: Any) -> tuple[torch.Tensor | None, ...]:
        *parameters, answer = ctx.saved_tensors
        splats, values, lists, camera, degree = ctx.kept
        d_planes = np.ascontiguousarray(grads[0].numpy())
        channels = values.shape[1]
        entry_grads = np.empty((len(lists.gaussian), MOMENTS + channels), splats.dtype)
        over_blocks(
            composite_backward, len(lists.starts) - 1, TILES, splats, values, lists.starts,
            lists.gaussian, answer.numpy(), d_planes, entry_grads,
        )  # fmt: skip
        arrays, n = _arrays(Gaussians(*parameters)), len(splats)
        out = [np.empty_like(a) for a in arrays]
        out += [np.empty((n, channels - FIXED), splats.dtype), np.empty((n, 2), splats.dtype)]
        over_blocks(
            project_backward, n, GAUSSIANS, *arrays, camera.packed(splats.dtype.type), degree,
            splats, values, entry_grads, lists.slots, lists.slot_starts, *out,
        )  # fmt: skip
        return (*(torch.from_numpy(a) for a in out), None, None)
