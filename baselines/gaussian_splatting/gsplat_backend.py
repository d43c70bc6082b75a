"""Rendering on CUDA through `gsplat` (Apache-2.0), behind the same interface as the CPU's kernels.

`gsplat` is imported on use: it is no dependency of this project. Its camera has no skew, and it
finishes a pixel one Gaussian earlier than ours (before the light falls below 1e-4, not after).
"""

import importlib
from typing import Any

import torch
from jaxtyping import Bool, Float

from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import Gaussians
from baselines.gaussian_splatting.projection_kernels import LOW_PASS
from scenediff_classic.cameras import camera_centre
from scenediff_classic.errors import InputError


def draw(
    gaussians: Gaussians,
    extra: Float[torch.Tensor, "n e"],
    shift: Float[torch.Tensor, "n 2"],
    camera: PinholeCamera,
    degree: int,
) -> tuple[Float[torch.Tensor, "c h w"], Bool[torch.Tensor, "n"]]:
    """Planes of red, green, blue, depth, extra channels and alpha; which Gaussians are in sight.

    `shift` moves nothing here, it only receives its gradient.

    Raises
    ------
    InputError
        If `gsplat` is not installed.
    """
    gsplat = _gsplat()
    g = gaussians
    like: dict[str, Any] = {"dtype": g.means.dtype, "device": g.means.device}
    centre = torch.tensor(camera_centre(camera.cam_from_world), **like)
    drawn, alpha, meta = gsplat.rasterization(
        g.means, g.quaternions, g.log_scales.exp(), g.opacities,
        torch.cat([g.colours(centre, degree), extra], dim=1),
        torch.tensor(camera.cam_from_world, **like)[None],
        torch.tensor(camera.intrinsics, **like)[None],
        camera.width, camera.height, near_plane=camera.near, eps2d=LOW_PASS, packed=False,
        render_mode="RGB+D",
    )  # fmt: skip
    centres = meta["means2d"]
    if shift.requires_grad and centres.requires_grad:
        centres.register_hook(lambda grad: _receive(shift, grad[0]))
    radii = meta["radii"][0]
    visible = (radii > 0).reshape(len(g), -1).all(dim=1)
    planes = torch.cat([drawn[0][..., :3], drawn[0][..., -1:], drawn[0][..., 3:-1], alpha[0]], -1)
    return planes.permute(2, 0, 1), visible


def _receive(shift: torch.Tensor, grad: torch.Tensor) -> None:
    shift.grad = grad.detach().clone() if shift.grad is None else shift.grad + grad.detach()


def _gsplat() -> Any:
    try:
        return importlib.import_module("gsplat")
    except ImportError as error:
        raise InputError(
            "Gaussian splatting on CUDA needs the package gsplat: install it with "
            "'pip install gsplat', or choose the device cpu."
        ) from error
