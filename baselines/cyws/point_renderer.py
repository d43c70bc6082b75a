"""Features as points in space, drawn into another picture: discs, blended front to back.

A point is a disc of some radius on the target picture. Of the discs over a pixel's centre the
nearest few by depth count; each covers ``1 - distance² / radius²`` of what is behind it.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

RADIUS = 1.5
"""Of a disc, in pixels of the target grid."""
PER_PIXEL = 8
"""Discs that count for a pixel."""


@dataclass(frozen=True)
class Splat:
    """Which points make up each pixel of a target grid, nearest first."""

    height: int
    width: int
    index: Int64[Tensor, "b p k"]
    """Number of the point; 0 where the weight is zero."""
    weight: Float[Tensor, "b p k"]
    """What each adds to the pixel; at most 1 in sum."""

    @property
    def visibility(self) -> Float[Tensor, "b 1 h w"]:
        """How much of each pixel is covered, 0 to 1."""
        return self.weight.sum(-1).reshape(len(self.weight), 1, self.height, self.width)

    def draw(self, features: Float[Tensor, "b c n"]) -> Float[Tensor, "b c h w"]:
        """The picture of the points' features; zero where nothing is."""
        batch, channels, points = features.shape
        rows = features.transpose(1, 2).reshape(batch * points, channels)
        first = torch.arange(batch, device=rows.device).reshape(-1, 1, 1) * points
        index = (self.index + first).reshape(-1, self.index.shape[-1])
        weight = self.weight.to(rows.dtype).reshape(index.shape)
        drawn = torch.nn.functional.embedding_bag(
            index, rows, per_sample_weights=weight, mode="sum"
        )
        grid = drawn.reshape(batch, self.height, self.width, channels)
        return grid.permute(0, 3, 1, 2).contiguous()


def splat(
    xy: Float[Tensor, "b n 2"],
    depth: Float[Tensor, "b n"],
    height: int,
    width: int,
    radius: float = RADIUS,
    per_pixel: int = PER_PIXEL,
) -> Splat:
    """Find the discs over each pixel.

    Parameters
    ----------
    xy : tensor (b, n, 2)
        Places on the target grid in pixels; the first pixel's centre is at (0.5, 0.5).
    depth : tensor (b, n)
        Of each point before the target camera. Points that are not ahead of it, or not finite,
        are left out; of equal ones the earlier number is in front.
    """
    batch = len(depth)
    reach = max(math.ceil(radius - 0.5), 0)
    steps = torch.arange(-reach, reach + 1, device=xy.device)
    down, right = (s.reshape(-1) for s in torch.meshgrid(steps, steps, indexing="ij"))
    known = torch.isfinite(xy).all(-1) & torch.isfinite(depth) & (depth > 0)
    place = torch.where(known[..., None], xy, xy.new_full((), -1e4)).clamp(-1e4, 1e6)
    column = place[..., 0].detach().floor().long()[..., None] + right
    row = place[..., 1].detach().floor().long()[..., None] + down
    square = (column + 0.5 - place[..., :1]) ** 2 + (row + 0.5 - place[..., 1:]) ** 2
    over = (square < radius * radius) & known[..., None]
    over &= (column >= 0) & (column < width) & (row >= 0) & (row < height)

    b, point, step = over.nonzero(as_tuple=True)
    cell = (b * height + row[b, point, step]) * width + column[b, point, step]
    order = torch.sort(depth.detach()[b, point], stable=True).indices
    order = order[torch.sort(cell[order], stable=True).indices]
    cell, point = cell[order], point[order]
    place_of = torch.arange(len(order), device=xy.device)
    starts = torch.ones_like(place_of, dtype=torch.bool)
    starts[1:] = cell[1:] != cell[:-1]
    rank = place_of - torch.cummax(torch.where(starts, place_of, 0), 0).values
    near = rank < per_pixel
    cell, point, rank, order = cell[near], point[near], rank[near], order[near]

    cells = batch * height * width
    index = point.new_zeros(cells, per_pixel)
    index[cell, rank] = point
    part = 1 - square[over][order] / (radius * radius)
    alpha = xy.new_zeros(cells, per_pixel).index_put((cell, rank), part)
    behind = torch.cumprod(1 - alpha, 1)
    free = torch.cat([torch.ones_like(behind[:, :1]), behind[:, :-1]], 1)
    shape = (batch, height * width, per_pixel)
    return Splat(height, width, index.reshape(shape), (alpha * free).reshape(shape))
