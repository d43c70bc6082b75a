"""More Gaussians where the pictures ask for them, fewer where they do nothing.

The rules of Kerbl et al. 2023, with a limit on the number.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from baselines.gaussian_splatting.adam import Adam
from baselines.gaussian_splatting.gaussians import Gaussians

CHILDREN = 2
CHILD_SIZE = 1 / 1.6
"""Scale of a part relative to the Gaussian that was split."""


@dataclass(frozen=True)
class DensifyConfig:
    """When and where Gaussians are added and removed."""

    start: int = 300
    """First iteration; 500 in the paper, whose trainings are much longer."""
    every: int = 100
    until: float = 0.5
    """Share of the training after which their number stays."""
    gradient: float = 2e-4
    """Mean pull on the picture (in half pictures) above which a Gaussian is too few."""
    small: float = 0.01
    """Larger ones (share of the scene's extent) are split, smaller ones doubled."""
    large: float = 0.5
    """Larger ones (share of the scene's extent) are removed."""
    opacity: float = 0.005
    """Fainter ones are removed."""
    reset_every: int = 3000
    """All opacities are cut down at multiples of this: what is needed comes back."""
    reset_opacity: float = 0.01
    most: int = 60_000
    """Never more than this many: time grows with them."""


@dataclass
class Pull:
    """How much the pictures pulled at each Gaussian since the last change of their number."""

    total: torch.Tensor
    count: torch.Tensor

    @staticmethod
    def start(gaussians: Gaussians) -> "Pull":
        """Nothing seen yet."""
        zero = torch.zeros(len(gaussians), device=gaussians.means.device)
        return Pull(zero, zero.clone())

    def add(self, shift_grad: torch.Tensor, visible: torch.Tensor, shape: tuple[int, int]) -> None:
        """Take in the gradient (n, 2) on one picture of (height, width)."""
        half = shift_grad.new_tensor([shape[1] / 2, shape[0] / 2])
        self.total += torch.linalg.vector_norm(shift_grad * half, dim=1)
        self.count += visible

    def mean(self) -> torch.Tensor:
        """Of the pictures in which each was in sight."""
        return self.total / self.count.clamp(min=1)


def densify(
    gaussians: Gaussians,
    adam: Adam,
    pull: torch.Tensor,
    extent: float,
    config: DensifyConfig,
    rng: np.random.Generator,
) -> tuple[Gaussians, Adam]:
    """Split large and double small Gaussians that are pulled at; remove faint and huge ones.

    Parameters
    ----------
    pull : tensor (n,)
        See `Pull`.
    extent : float
        Of the scene, in world units.
    """
    size = gaussians.log_scales.max(dim=1).values
    wanted = pull > config.gradient
    room = max(config.most - len(gaussians), 0)
    if int(wanted.sum()) > room:  # each adds one: those that are pulled at most come first
        first = torch.sort(pull, descending=True, stable=True).indices[:room]
        chosen = torch.zeros_like(wanted)
        chosen[first] = True
        wanted &= chosen
    large = size > math.log(config.small * extent)
    kept = (
        ~(wanted & large)
        & (gaussians.opacities >= config.opacity)
        & (size < math.log(config.large * extent))
    )
    copies = gaussians.map(lambda t: t[wanted & ~large])
    parts = _split(gaussians.map(lambda t: t[wanted & large]), rng)
    new = len(copies) + len(parts)
    joined = [
        torch.cat([getattr(g, name) for g in (gaussians.map(lambda t: t[kept]), copies, parts)])
        for name in gaussians.__dataclass_fields__
    ]
    state = adam.map(lambda t: torch.cat([t[kept], t.new_zeros((new, *t.shape[1:]))]))
    return Gaussians(*joined), state


def _split(gaussians: Gaussians, rng: np.random.Generator) -> Gaussians:
    """Two smaller ones drawn from each."""
    many = gaussians.map(lambda t: torch.cat([t] * CHILDREN))
    draw = torch.from_numpy(rng.normal(size=(len(many), 3))).to(many.means)
    along = many.rotations @ (draw * many.log_scales.exp())[:, :, None]
    return Gaussians(
        many.means + along[:, :, 0],
        many.log_scales + math.log(CHILD_SIZE),
        many.quaternions,
        many.opacity_logits,
        many.sh,
    )


def reset_opacities(gaussians: Gaussians, adam: Adam, config: DensifyConfig) -> None:
    """Cut all opacities down, in place, and forget their momentum."""
    highest = math.log(config.reset_opacity / (1 - config.reset_opacity))
    gaussians.opacity_logits.clamp_(max=highest)
    for state in (adam.mean, adam.square):
        state.opacity_logits.zero_()
