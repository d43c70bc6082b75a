"""Small random Gaussians and cameras for tests."""

import numpy as np
import torch

from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import Gaussians

CAMERA = PinholeCamera(np.array([[40.0, 0.5, 25], [0, 42, 18], [0, 0, 1]]), np.eye(4), 37, 50, 0.1)
"""With skew, and a size that is no multiple of a tile."""


def cloud(
    count: int, dtype: torch.dtype = torch.float64, *, seed: int = 0, degree: int = 3,
    log_scale: float = -1.5,
) -> Gaussians:  # fmt: skip
    """Random Gaussians before `CAMERA`, some of them out of its sight."""
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=draw, dtype=torch.float64)

    means = normal(count, 3) * torch.tensor([1.6, 1.2, 1.0]) + torch.tensor([0, 0, 4.0])
    scales = log_scale + 0.5 * normal(count, 3)
    colours = 0.3 * normal(count, (degree + 1) ** 2, 3)
    parts = (means, scales, normal(count, 4), 2 * normal(count), colours)
    return Gaussians(*parts).map(lambda t: t.to(dtype))
