"""How the points of one picture of a pair come to lie in the other.

All modes are one thing: a depth for every pixel and an affine map in four dimensions. With
picture coordinates ``u, v`` from 0 to 1, the point ``(d·u, d·v, d, 1)`` of one picture becomes
``(d'·u', d'·v', d', 1)`` of the other.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from baselines.cyws.point_renderer import Splat, splat
from scenediff_classic.errors import AlignmentError

SAMPLES = 200
"""Draws of the robust fit."""


@dataclass(frozen=True)
class Registration:
    """Points of a batch of pairs, and the maps between their pictures."""

    depth: Float[Tensor, "b 2 h w"]
    """NaN = unknown: no point. One everywhere if there is no depth at all."""
    across: Float[Tensor, "b 2 4 4"]
    """First picture to second, second to first."""
    stretched: bool = False
    """Let the centres of the outermost pixels have coordinates 0 and 1, as the published code does
    (half a pixel off); else the edges have."""

    def __post_init__(self) -> None:
        """Check the shapes."""
        if self.depth.shape[:2] != (len(self.depth), 2) or self.across.shape[1:] != (2, 4, 4):
            raise ValueError("depth must be (b, 2, h, w) and across (b, 2, 4, 4)")

    def to(self, device: torch.device | str) -> "Registration":
        """The same on a device."""
        return Registration(self.depth.to(device), self.across.to(device), self.stretched)

    def splat(self, height: int, width: int) -> tuple[Splat, Splat]:
        """The second picture's points on a grid of the first, and the first's on one of the
        second."""
        depth, places = self.carried_grid(height, width)
        size = depth.new_tensor([width, height])
        uv = places[..., :2]
        xy = uv * (size - 1) + 0.5 if self.stretched else uv * size
        first, second = (splat(xy[:, k], places[:, k, :, 2], height, width) for k in (1, 0))
        return first, second

    def carried_grid(
        self, height: int, width: int
    ) -> tuple[Float[Tensor, "b 2 n"], Float[Tensor, "b 2 n 3"]]:
        """Depth at the cells of a grid, and (u', v', depth') of each in the other picture."""
        device = self.depth.device
        rows = (torch.arange(height, device=device) + 0.5) * self.depth.shape[2] / height
        columns = (torch.arange(width, device=device) + 0.5) * self.depth.shape[3] / width
        depth = self.depth[:, :, rows.long()[:, None], columns.long()].flatten(2)
        return depth, self._across(_grid(height, width, self.stretched, depth), depth)

    def _across(self, uv: Tensor, depth: Tensor) -> Tensor:
        """(u', v', depth') of points (b, 2, n, 2) in the other picture."""
        ahead = depth[..., None]
        points = torch.cat([uv * ahead, ahead, torch.ones_like(ahead)], -1)
        moved = points @ self.across.transpose(2, 3).to(points.dtype)
        far = moved[..., 2:3]
        return torch.cat([moved[..., :2] / torch.where(far > 0, far, torch.nan), far], -1)

    def carry(
        self, pair: int, picture: int, uv: Float64[np.ndarray, "n 2"]
    ) -> Float64[np.ndarray, "n 2"]:
        """Places of one picture (0 to 1) in the other; NaN where depth is unknown."""
        height, width = self.depth.shape[2:]
        column = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
        row = np.clip((uv[:, 1] * height).astype(int), 0, height - 1)
        depth = self.depth[pair, picture].cpu().double().numpy()[row, column, None]
        points = np.concatenate([uv * depth, depth, np.ones_like(depth)], 1)
        moved = points @ self.across[pair, picture].cpu().double().numpy().T
        ahead = np.where(moved[:, 2:3] > 0, moved[:, 2:3], np.nan)
        return moved[:, :2] / ahead

    def difference(self, features: Float[Tensor, "b 2 c h w"]) -> Float[Tensor, "b 2 c h w"]:
        """Of either picture: its features less the other's drawn into it, where any are."""
        height, width = features.shape[-2:]
        onto_first, onto_second = self.splat(height, width)
        first, second = features[:, 0], features[:, 1]
        drawn = onto_first.draw(second.flatten(2)), onto_second.draw(first.flatten(2))
        seen = onto_first.visibility.to(first), onto_second.visibility.to(first)
        return torch.stack([seen[0] * (first - drawn[0]), seen[1] * (second - drawn[1])], 1)


def plain_difference(features: Float[Tensor, "b 2 c h w"]) -> Float[Tensor, "b 2 c h w"]:
    """The mode *identity*: pixels correspond as they are, and all are seen."""
    return features - features.flip(1)


def _grid(height: int, width: int, stretched: bool, like: Tensor) -> Tensor:
    y = torch.arange(height, device=like.device, dtype=like.dtype)
    x = torch.arange(width, device=like.device, dtype=like.dtype)
    if stretched:
        v, u = y / max(height - 1, 1), x / max(width - 1, 1)
    else:
        v, u = (y + 0.5) / height, (x + 0.5) / width
    return torch.stack(torch.meshgrid(u, v, indexing="xy"), -1).reshape(1, 1, -1, 2)


# --- modes --------------------------------------------------------------------------------------


def known_geometry(
    depth: Float[Tensor, "b 2 h w"],
    intrinsics: Float64[np.ndarray, "b 2 3 3"],
    cam_from_world: Float64[np.ndarray, "b 2 4 4"],
) -> Registration:
    """From z-depth and cameras; intrinsics in pixels of the depth maps."""
    height, width = depth.shape[2:]
    lens = np.broadcast_to(np.eye(4), (*intrinsics.shape[:2], 4, 4)).copy()
    lens[..., :3, :3] = np.diag([1 / width, 1 / height, 1.0]) @ intrinsics
    world_from_picture = np.linalg.inv(lens @ cam_from_world)
    across = (lens @ cam_from_world)[:, ::-1] @ world_from_picture
    return Registration(depth, torch.from_numpy(across).float())


def from_correspondences(
    depth: Float[Tensor, "2 h w"],
    first: Float64[np.ndarray, "n 2"],
    second: Float64[np.ndarray, "n 2"],
    *,
    seed: int = 0,
    tolerance: float = 0.05,
) -> Registration:
    """The affine map that fits matched places best: least squares on the largest consensus.

    Parameters
    ----------
    first, second : array (n, 2)
        Matched places in either picture, 0 to 1.
    seed : int
        Decides the draws: the same matches give the same map.
    tolerance : float
        Largest distance of an inlier, as a share of the median depth.

    Raises
    ------
    AlignmentError
        With fewer than five matches of known depth, or none that agree.
    """
    one = Registration(depth[None], torch.eye(4).expand(1, 2, 4, 4))
    a, b = (_lifted(one, k, uv) for k, uv in enumerate((first, second)))
    known = np.isfinite(a).all(1) & np.isfinite(b).all(1)
    a, b = a[known], b[known]
    if len(a) < 5:
        raise AlignmentError("Fewer than five matches have a depth: the pictures share too little.")
    rng = np.random.default_rng(seed)
    limit = tolerance * float(np.median(np.concatenate([a[:, 2], b[:, 2]])))
    best = np.zeros(len(a), bool)
    for _ in range(SAMPLES):
        some = rng.choice(len(a), 4, replace=False)
        agree = np.linalg.norm(a @ _fit(a[some], b[some]).T - b, axis=1) < limit
        if agree.sum() > best.sum():
            best = agree
    if best.sum() < 5:
        raise AlignmentError("The matches agree on no map between the pictures.")
    across = np.stack([_fit(a[best], b[best]), _fit(b[best], a[best])])
    return Registration(depth[None], torch.from_numpy(across[None]).float())


def _lifted(one: Registration, picture: int, uv: np.ndarray) -> np.ndarray:
    height, width = one.depth.shape[2:]
    column = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    row = np.clip((uv[:, 1] * height).astype(int), 0, height - 1)
    depth = one.depth[0, picture].cpu().double().numpy()[row, column, None]
    return np.concatenate([uv * depth, depth, np.ones_like(depth)], 1)


def _fit(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Least-squares affine 4x4 that takes rows of `a` to rows of `b`."""
    out = np.eye(4)
    out[:3] = np.linalg.lstsq(a, b[:, :3], rcond=None)[0].T
    return out


def affine_2d(across: Float64[np.ndarray, "b 2 3"], height: int, width: int) -> Registration:
    """Without depth: ``u', v' = A (u, v, 1)`` from the first picture to the second."""
    both = np.broadcast_to(np.eye(4), (len(across), 2, 4, 4)).copy()
    both[:, 0, :2, :3] = across
    both[:, 1] = np.linalg.inv(both[:, 0])
    depth = torch.ones(len(across), 2, height, width)
    return Registration(depth, torch.from_numpy(both).float())
