"""A scalar that every Gaussian carries, learned from masks while the geometry is frozen.

``fit_channel(gaussians, cameras, masks) -> Channel`` optimises the scalar and an opacity of its
own; ``channel.render(camera)`` draws it. `rasterizer.accumulate` finds such values in closed form.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float32

from baselines.gaussian_splatting.adam import update
from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import Gaussians
from baselines.gaussian_splatting.losses import Target, photometric_loss
from baselines.gaussian_splatting.rasterizer import render
from baselines.gaussian_splatting.threads import one_torch_thread

Loss = Callable[[Float[torch.Tensor, "1 h w"], Target], Float[torch.Tensor, ""]]
"""Of a drawn channel and the mask that it should show."""


@dataclass(frozen=True)
class ChannelConfig:
    """How a channel is learned."""

    iterations: int = 600
    value_rate: float = 0.05
    opacity_rate: float = 0.05
    loss: Loss = photometric_loss
    """0.8 L1 + 0.2 (1 - SSIM) by default."""
    seed: int = 0


@dataclass(frozen=True)
class Channel:
    """A scalar for each Gaussian, with an opacity of its own."""

    gaussians: Gaussians
    """Geometry as it was; opacities are the channel's."""
    logits: Float[torch.Tensor, "n"]
    """The scalar is their sigmoid."""

    def render(self, camera: PinholeCamera) -> Float32[np.ndarray, "h w"]:
        """The channel as a camera sees it, 0 to 1."""
        with torch.no_grad():
            values = torch.sigmoid(self.logits)[:, None]
            drawn = render(self.gaussians, camera, extra=values, degree=0)
        return drawn.extra[..., 0].cpu().numpy()


def fit_channel(
    gaussians: Gaussians,
    cameras: Sequence[PinholeCamera],
    masks: Sequence[Float[np.ndarray, "h w"]],
    config: ChannelConfig = ChannelConfig(),
    *,
    start: Channel | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Channel:
    """Learn a channel that shows the masks; means, scales, rotations and colours stay.

    Parameters
    ----------
    masks : sequence of arrays
        Values from 0 to 1 of each camera's pixels; NaN = unknown, which counts for nothing.
    start : Channel, optional
        Go on with this one; by default a low value everywhere and the Gaussians' own opacity.
    progress : callable, optional
        Called as ``progress(done, total)``.
    """
    frozen = gaussians.detached()
    device = frozen.means.device
    targets = [_target(mask, device) for mask in masks]
    logits = start.logits.clone() if start else torch.full_like(frozen.opacity_logits, -2.0)
    opacity = (start.gaussians if start else frozen).opacity_logits.clone()
    rows = [(logits, config.value_rate), (opacity, config.opacity_rate)]
    moments = [(torch.zeros_like(t), torch.zeros_like(t)) for t, _ in rows]
    rng, queue = np.random.default_rng(config.seed), []
    for number in range(1, config.iterations + 1):
        queue = queue or rng.permutation(len(targets)).tolist()
        index = queue.pop()
        leaves = [t.detach().requires_grad_() for t, _ in rows]
        shaped = replace(frozen, opacity_logits=leaves[1])
        values = torch.sigmoid(leaves[0])[:, None]
        drawn = render(shaped, cameras[index], extra=values, degree=0)
        with one_torch_thread():
            config.loss(drawn.extra.permute(2, 0, 1), targets[index]).backward()
        for leaf, (row, rate), (mean, square) in zip(leaves, rows, moments, strict=True):
            if leaf.grad is None:
                continue
            rates = np.array([rate])
            update(
                row[:, None], leaf.grad[:, None], mean[:, None], square[:, None], rates,
                drawn.visible, number,
            )  # fmt: skip
        if progress:
            progress(number, config.iterations)
    return Channel(replace(frozen, opacity_logits=opacity), logits)


def _target(mask: Float[np.ndarray, "h w"], device: torch.device) -> Target:
    unknown = ~np.isfinite(mask)
    known = np.where(unknown, 0, mask).astype(np.float32)[None]
    return Target.of(torch.from_numpy(known).to(device), unknown)
