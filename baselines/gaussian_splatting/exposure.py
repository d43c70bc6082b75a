"""Captures differ in light: an affine map of colour for each picture."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float

RIDGE = 1e-3
"""Pull towards "no change", per pixel: only colours that are really there decide."""


@dataclass(frozen=True)
class Exposures:
    """Affine colour maps of `n` pictures: captured = matrix @ scene + offset."""

    maps: Float[torch.Tensor, "n 3 4"]

    @staticmethod
    def start(count: int) -> "Exposures":
        """No change of colour."""
        return Exposures(torch.eye(3, 4).repeat(count, 1, 1))

    def apply(
        self, planes: Float[torch.Tensor, "3 h w"], index: int
    ) -> Float[torch.Tensor, "3 h w"]:
        """The scene's colours as picture `index` shows them."""
        return applied(planes, self.maps[index])


def applied(
    planes: Float[torch.Tensor, "3 h w"], colour_map: Float[torch.Tensor, "3 4"]
) -> Float[torch.Tensor, "3 h w"]:
    """Colours after an affine map."""
    flat = torch.addmm(colour_map[:, 3:], colour_map[:, :3], planes.reshape(3, -1))
    return flat.reshape(planes.shape)


def fit_exposure(
    rendered: Float[np.ndarray, "h w 3"],
    captured: Float[np.ndarray, "h w 3"],
    known: Bool[np.ndarray, "h w"],
    rounds: int = 5,
) -> Float[np.ndarray, "3 4"]:
    """The affine map that brings a rendered picture nearest to a captured one.

    Least squares over the known pixels, again and again with less weight for those that do not
    fit: what changed has no say. Both pictures range from 0 to 1.
    """
    x = np.c_[rendered[known], np.ones(known.sum())].astype(np.float64)
    y = captured[known].astype(np.float64)
    still = np.eye(3, 4)
    ridge = RIDGE * max(len(x), 1) * np.eye(4)
    weights, colour_map = np.ones(len(x)), still
    for _ in range(rounds):
        left = (x * weights[:, None]).T @ x + ridge
        right = (x * weights[:, None]).T @ y + ridge @ still.T
        colour_map = np.linalg.solve(left, right).T
        error = np.abs(y - x @ colour_map.T).mean(axis=1)
        spread = max(1.4826 * float(np.median(error)) if len(error) else 0.0, 1e-3)
        weights = 1 / (1 + (error / spread) ** 2)
    return colour_map
