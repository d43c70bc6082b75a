"""The readable twin of the rasteriser: every pixel against every Gaussian, in plain PyTorch.

Same rules as the compiled kernels, gradients by PyTorch alone; for tests, and to read.
"""

import torch
from jaxtyping import Float

from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import Gaussians
from baselines.gaussian_splatting.projection_kernels import LOW_PASS, MIN_ALPHA
from baselines.gaussian_splatting.rasterizer import Rendering
from baselines.gaussian_splatting.tile_kernels import MAX_ALPHA, OPAQUE


def render_densely(
    gaussians: Gaussians,
    camera: PinholeCamera,
    *,
    extra: Float[torch.Tensor, "n e"] | None = None,
    degree: int | None = None,
    screen_shift: Float[torch.Tensor, "n 2"] | None = None,
) -> Rendering:
    """As `rasterizer.render`, in memory and time proportional to pixels times Gaussians."""
    means = gaussians.means
    degree = gaussians.degree if degree is None else min(degree, gaussians.degree)
    numbers = torch.tensor(camera.packed(_numpy_type(means.dtype)))
    R, t, centre, near = numbers[:9].reshape(3, 3), numbers[9:12], numbers[22:25], numbers[21]
    fx, fy, skew, cx, cy = numbers[12:17]
    x, y, z = (means @ R.T + t).unbind(1)
    xy = torch.stack([(fx * x + skew * y) / z + cx, fy * y / z + cy], 1)
    xy = xy if screen_shift is None else xy + screen_shift

    u, v = (x / z).clamp(numbers[17], numbers[18]), (y / z).clamp(numbers[19], numbers[20])
    zero = torch.zeros_like(z)
    J = torch.stack([fx / z, skew / z, -(fx * u + skew * v) / z, zero, fy / z, -fy * v / z], 1)
    U = J.reshape(-1, 2, 3) @ R @ gaussians.rotations
    U = U * gaussians.log_scales.exp()[:, None]
    covariance = U @ U.transpose(1, 2) + LOW_PASS * torch.eye(2, dtype=means.dtype)
    inverse = torch.linalg.inv(covariance)

    opacity = gaussians.opacities
    drawn = torch.nonzero((z > near) & (opacity > MIN_ALPHA))[:, 0]
    drawn = drawn[torch.sort(z[drawn], stable=True).indices]
    rows, cols = torch.meshgrid(
        torch.arange(camera.height), torch.arange(camera.width), indexing="ij"
    )
    pixels = torch.stack([cols, rows], -1).to(means.dtype) + 0.5
    offset = pixels[:, :, None] - xy[drawn]
    power = -0.5 * torch.einsum("hwni,nij,hwnj->hwn", offset, inverse[drawn], offset)
    alpha = (opacity[drawn] * power.exp()).clamp(max=MAX_ALPHA)
    alpha = torch.where(power >= -torch.log(opacity[drawn] / MIN_ALPHA), alpha, 0)
    before = torch.cumprod(torch.cat([torch.ones_like(alpha[..., :1]), 1 - alpha], -1), -1)
    weights = torch.where(before[..., :-1] >= OPAQUE, alpha * before[..., :-1], 0)

    colour = gaussians.colours(centre, degree)
    extra = means.new_zeros((len(means), 0)) if extra is None else extra
    values = torch.cat([colour, z[:, None], extra], 1)[drawn]
    drawing = weights @ values
    visible = torch.zeros(len(means), dtype=torch.bool)
    visible[drawn] = weights.sum((0, 1)) > 0
    return Rendering(drawing[..., :3], drawing[..., 3], weights.sum(-1), drawing[..., 4:], visible)


def _numpy_type(dtype: torch.dtype) -> type:
    return torch.zeros(0, dtype=dtype).numpy().dtype.type
