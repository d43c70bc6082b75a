"""Planes that things stand on, lean against or hang from: table tops, floors, walls, fronts.

A plane in space is exactly affine in inverse depth over the picture:
``1 / depth = plane @ (x, y, 1)``, with pixel coordinates (x, y).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, Int32

from scenediff_classic.cameras import pixel_centres
from scenediff_classic.types import View

_THIN = 17
"""Planes are compared on every 17th pixel."""
_STRIP = 7
"""Pixels: a plane that cuts another surface meets it in a strip narrower than this."""
_PIECE = 0.1
"""Least share of a piece in its plane."""
_ENOUGH = 100
"""Pixels with depth below which no plane is sought."""


@dataclass(frozen=True)
class SupportConfig:
    """When a plane is a support and not the face of a thing."""

    tolerance: float = 0.01
    """Relative difference of depth within which a pixel lies on a plane."""
    cell: int = 16
    """Side of the square patches whose planes are tried, in pixels."""
    least_size: float = 0.10
    """Square root of the visible area, as a fraction of the extent of all that the view shows."""
    least_share: float = 0.01
    """Share of the picture."""
    least_size_up: float = 0.07
    """The same two for planes that face upwards: what carries things is often seen flat."""
    least_share_up: float = 0.003
    least_piece: float = 0.002
    """Share of the picture below which a piece of a plane is no part of it: planes run on, and
    cut things that stand elsewhere."""
    upward: float = 0.3
    """A plane faces upwards if its normal points up in the picture by more than this."""
    most: int = 16
    """Planes that are tried, from the largest on."""


@dataclass(frozen=True)
class Supports:
    """The support planes of a view."""

    labels: Int32[np.ndarray, "h w"]
    """Position in `planes`; -1 where no support is seen."""
    planes: Float64[np.ndarray, "n 3"]
    """In space: ``plane @ point == 1`` for points in camera coordinates."""
    level: Bool[np.ndarray, "n"]
    """True for planes that face upwards."""

    @property
    def up(self) -> Float64[np.ndarray, "3"] | None:
        """Unit normal, in camera coordinates, of the largest plane that faces upwards, if any."""
        areas = np.bincount(self.labels[self.labels >= 0], minlength=len(self.planes)) * self.level
        return _normal(self.planes[np.argmax(areas)]) if self.level.any() else None

    def above(self, points: Float64[np.ndarray, "n 3"]) -> Bool[np.ndarray, "m"]:
        """Whether points (camera coordinates) mostly lie on the camera's side of level planes."""
        return np.mean(points @ self.planes[self.level].T < 1, axis=0) > 0.5


def support_planes(view: View, config: SupportConfig) -> Supports:
    """The large planes of a view, the largest first; none where too little depth is known.

    Planes of small square patches are the candidates. The one that most pixels lie on is refitted
    and takes its pixels; then the next.
    """
    height, width = view.shape
    labels = np.full(view.shape, -1, np.int32)
    known = np.isfinite(view.depth) & (view.depth > 0)
    inverse = 1 / np.where(known, view.depth, np.nan).astype(np.float64)
    xy1 = np.dstack([pixel_centres(height, width), np.ones(view.shape)])
    thin = np.flatnonzero(known)[::_THIN]
    rows, target = xy1.reshape(-1, 3)[thin], inverse.ravel()[thin]
    candidates = _patch_planes(xy1, inverse, config)
    fits = np.abs(rows @ candidates.T / target[:, None] - 1) < config.tolerance
    open_rows, open_pixels = np.ones(len(thin), bool), known.copy()
    planes, level = [], []
    least = min(config.least_share, config.least_share_up) * known.size
    for _ in range(config.most if np.count_nonzero(known) >= _ENOUGH and len(candidates) else 0):
        counts = fits[open_rows].sum(axis=0)
        best = int(np.argmax(counts))
        if counts[best] * _THIN < least:
            break
        plane = _refitted(candidates[best], rows[open_rows], target[open_rows], config.tolerance)
        on_plane = open_pixels & (np.abs(xy1 @ plane / inverse - 1) < config.tolerance)
        open_rows &= ~on_plane.ravel()[thin]
        fits[:, best] = False
        on_plane = _large_pieces(on_plane, config.least_piece)
        in_space = view.intrinsics.T @ plane
        facing_up = bool(_normal(in_space)[1] < -config.upward)
        size, share = _size(view, in_space, on_plane, xy1), float(on_plane.mean())
        wanted = (
            (config.least_size_up, config.least_share_up)
            if facing_up
            else (config.least_size, config.least_share)
        )
        if size < wanted[0] * _extent(view, known, xy1) or share < wanted[1]:
            continue
        open_pixels &= ~on_plane
        labels[on_plane] = len(planes)
        planes.append(in_space)
        level.append(facing_up)
    return Supports(labels, np.array(planes).reshape(-1, 3), np.array(level, bool))


def camera_points(view: View) -> Float64[np.ndarray, "h w 3"]:
    """Camera coordinates of every pixel; NaN where depth is unknown."""
    xy1 = np.dstack([pixel_centres(*view.shape), np.ones(view.shape)])
    return xy1 @ np.linalg.inv(view.intrinsics).T * view.depth[..., None]


def _patch_planes(
    xy1: Float64[np.ndarray, "h w 3"], inverse: Float64[np.ndarray, "h w"], config: SupportConfig
) -> Float64[np.ndarray, "n 3"]:
    """Planes of all patches that are flat and mostly known."""
    cell, found = config.cell, []
    for top in range(0, inverse.shape[0] - cell + 1, cell):
        for left in range(0, inverse.shape[1] - cell + 1, cell):
            patch = np.s_[top : top + cell, left : left + cell]
            known = np.isfinite(inverse[patch])
            if known.mean() < 0.5:
                continue
            rows, target = xy1[patch][known], inverse[patch][known]
            plane = np.linalg.lstsq(rows, target, rcond=None)[0]
            on_plane = np.abs(rows @ plane / target - 1) < config.tolerance / 2
            if on_plane.mean() > 0.8:
                found.append(_refitted(plane, rows, target, config.tolerance / 2))
    return np.array(found).reshape(-1, 3)


def _refitted(
    plane: Float64[np.ndarray, "3"],
    rows: Float64[np.ndarray, "n 3"],
    target: Float64[np.ndarray, "n"],
    tolerance: float,
) -> Float64[np.ndarray, "3"]:
    for _ in range(2):
        near = np.abs(rows @ plane / target - 1) < tolerance
        plane = np.linalg.lstsq(rows[near], target[near], rcond=None)[0]
    return plane


def _large_pieces(mask: Bool[np.ndarray, "h w"], least: float) -> Bool[np.ndarray, "h w"]:
    """Without strips, and without pieces that are small, at all or among the others."""
    broad = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((_STRIP, _STRIP)))
    _, pieces = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    sizes = np.bincount(pieces.ravel(), broad.ravel())
    sizes[0] = 0
    keep = sizes >= max(least * mask.size, _PIECE * sizes.sum())
    keep[0] = False
    return keep[np.asarray(pieces, np.int32)]


def _normal(plane: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "3"]:
    """Unit normal towards the camera."""
    return -plane / np.linalg.norm(plane)


def _size(
    view: View,
    plane: Float64[np.ndarray, "3"],
    mask: Bool[np.ndarray, "h w"],
    xy1: Float64[np.ndarray, "h w 3"],
) -> float:
    """Square root of the area that pixels cover on a plane, in the view's unit."""
    rays = xy1[mask] @ np.linalg.inv(view.intrinsics).T
    cosine = np.abs(rays @ _normal(plane))  # of unnormalised rays: z cancels the rest
    per_pixel = view.depth[mask] ** 2 / (view.intrinsics[0, 0] * view.intrinsics[1, 1])
    return float(np.sqrt(np.sum(per_pixel / np.maximum(cosine, 0.05))))


def _extent(view: View, known: Bool[np.ndarray, "h w"], xy1: Float64[np.ndarray, "h w 3"]) -> float:
    """Longest side of the box around what the view shows, without the outermost hundredths."""
    points = xy1[known][::7] @ np.linalg.inv(view.intrinsics).T * view.depth[known][::7, None]
    low, high = np.percentile(points, [1, 99], axis=0)
    return float(np.max(high - low))
