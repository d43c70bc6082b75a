"""The readable twin of the rasteriser: every pixel against every Gaussian, in plain PyTorch.

Same rules as the compiled kernels, gradients by PyTorch alone; for tests, and to read.
"""

import torch
from jaxtyping import Float

from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import SH_0, Gaussians
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
    U = J.reshape(-1, 2, 3) @ R @ rotation_matrices(gaussians.quaternions)
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

    away = torch.nn.functional.normalize(means - centre, dim=1)
    colour = torch.einsum(
        "nk,nkc->nc", harmonics(away, degree), gaussians.sh[:, : (degree + 1) ** 2]
    )
    colour = (colour + 0.5).clamp(min=0)
    extra = means.new_zeros((len(means), 0)) if extra is None else extra
    values = torch.cat([colour, z[:, None], extra], 1)[drawn]
    drawing = weights @ values
    visible = torch.zeros(len(means), dtype=torch.bool)
    visible[drawn] = weights.sum((0, 1)) > 0
    return Rendering(drawing[..., :3], drawing[..., 3], weights.sum(-1), drawing[..., 4:], visible)


def rotation_matrices(quaternions: Float[torch.Tensor, "n 4"]) -> Float[torch.Tensor, "n 3 3"]:
    """Rotation matrices of quaternions (w, x, y, z) of any length."""
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=1).unbind(1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, 1).reshape(-1, 3, 3)


def harmonics(directions: Float[torch.Tensor, "n 3"], degree: int) -> Float[torch.Tensor, "n k"]:
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


def _numpy_type(dtype: torch.dtype) -> type:
    return torch.zeros(0, dtype=dtype).numpy().dtype.type
