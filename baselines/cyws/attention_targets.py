"""Where each place of a picture is in the other one: what co-attention should look at."""

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from baselines.cyws.registration import Registration

AGREE = 0.05
"""Largest difference of depths at the same place, as a share."""


def correspondences(
    registration: Registration, height: int, width: int
) -> tuple[Int64[Tensor, "b 2 n"], Bool[Tensor, "b 2 n"]]:
    """The other picture's cell for each cell of a grid, and where both show the same surface."""
    depth, moved = registration.carried_grid(height, width)
    inside = (moved[..., :2] >= 0).all(-1) & (moved[..., :2] < 1).all(-1) & depth.isfinite()
    uv = torch.where(inside[..., None], moved[..., :2], 0)
    cell = (uv[..., 1] * height).long() * width + (uv[..., 0] * width).long()
    there = registration.depth.flip(1)
    rows = (uv[..., 1] * there.shape[2]).long()
    columns = (uv[..., 0] * there.shape[3]).long()
    found = there.flatten(2).gather(2, rows * there.shape[3] + columns)
    same = ((found - moved[..., 2]).abs() < AGREE * moved[..., 2]) & inside
    return cell, same


def attention_loss(
    logits: list[tuple[tuple[int, int], Tensor]], registration: Registration
) -> Float[Tensor, ""]:
    """Cross-entropy of where each place looks, mean over levels; places without any count not."""
    total = registration.depth.new_zeros(())
    for (height, width), seen in logits:
        cell, same = correspondences(registration, height, width)
        missed = torch.nn.functional.cross_entropy(
            seen.float().flatten(0, 2), cell.flatten(), reduction="none"
        )
        total = total + (missed * same.flatten()).sum() / same.sum().clamp(min=1)
    return total / len(logits)
