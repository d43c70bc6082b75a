"""Adam (Kingma and Ba 2015) over Gaussians: one row of state for each, moved along with it.

Only the Gaussians in sight are updated: the others have no gradient, and their momentum would let
them drift. It also spares the memory traffic.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
import torch
from jaxtyping import Bool
from numba import njit

from baselines.gaussian_splatting.gaussians import Gaussians
from baselines.gaussian_splatting.threads import GAUSSIANS, over_blocks

BETAS = (0.9, 0.999)
EPSILON = 1e-15
NAMES = tuple(f.name for f in fields(Gaussians))


@dataclass(frozen=True)
class Adam:
    """Running means of the gradients and of their squares, shaped like the Gaussians."""

    mean: Gaussians
    square: Gaussians

    @staticmethod
    def start(gaussians: Gaussians) -> "Adam":
        """No momentum."""
        return Adam(gaussians.map(torch.zeros_like), gaussians.map(torch.zeros_like))

    def map(self, change: Callable[[torch.Tensor], torch.Tensor]) -> "Adam":
        """The state of other Gaussians: a selection, or with rows appended."""
        return Adam(self.mean.map(change), self.square.map(change))

    def step(
        self,
        gaussians: Gaussians,
        rates: dict[str, np.ndarray],
        visible: Bool[torch.Tensor, "n"],
        number: int,
    ) -> None:
        """Change the Gaussians in place, by their gradients.

        Parameters
        ----------
        rates : dict
            For each tensor of `Gaussians`, the rate of each of a row's numbers.
        number : int
            Of this step, from 1.
        """
        for name in NAMES:
            parameter = getattr(gaussians, name)
            tensors = [parameter, parameter.grad, getattr(self.mean, name)]
            tensors = [t.detach().reshape(len(gaussians), -1) for t in tensors]
            tensors.append(getattr(self.square, name).reshape(len(gaussians), -1))
            update(*tensors, rates[name], visible, number)


def update(
    parameter: torch.Tensor,
    grad: torch.Tensor,
    mean: torch.Tensor,
    square: torch.Tensor,
    rates: np.ndarray,
    visible: torch.Tensor,
    number: int,
) -> None:
    """One step of Adam, in place, on the visible rows of (n, k) tensors."""
    b1, b2 = BETAS
    steps = rates / (1 - b1**number)
    scale = 1 / (1 - b2**number)
    if not parameter.is_cuda:
        dtype = parameter.numpy().dtype
        arrays = [t.numpy() for t in (parameter, grad, mean, square)]
        numbers = np.array([b1, b2, scale, EPSILON], dtype)
        over_blocks(
            _update, len(parameter), GAUSSIANS, *arrays, steps.astype(dtype), visible.numpy(),
            numbers,
        )  # fmt: skip
        return
    seen = visible[:, None]
    mean.copy_(torch.where(seen, b1 * mean + (1 - b1) * grad, mean))
    square.copy_(torch.where(seen, b2 * square + (1 - b2) * grad * grad, square))
    along = torch.tensor(steps, dtype=mean.dtype, device=mean.device)
    parameter.sub_(seen * along * mean / ((square * scale).sqrt() + EPSILON))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def _update(parameter, grad, mean, square, steps, visible, numbers, first, last):
    b1, b2, scale, epsilon = numbers
    one = parameter.dtype.type(1)
    for i in range(first, last):
        if not visible[i]:
            continue
        for k in range(parameter.shape[1]):
            g = grad[i, k]
            m = b1 * mean[i, k] + (one - b1) * g
            v = b2 * square[i, k] + (one - b2) * g * g
            mean[i, k], square[i, k] = m, v
            parameter[i, k] -= steps[k] * m / (np.sqrt(v * scale) + epsilon)
