"""Light that fell otherwise on large surfaces, taken out of a render before it is compared.

Exposure changes a whole picture, and an affine map of its colours makes up for it. A lamp that went
on changes each surface by itself: a table top that a warm lamp lights now differs more than a new
thing on it. On one large plane, though, light changes slowly from place to place, and things do
not: what render and picture have in common there, smoothly, is light; the rest is change.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from baselines.gaussian_splatting.exposure import fit_exposure
from baselines.splat_change.models import Render
from scenediff_classic.cameras import unproject
from scenediff_classic.types import View

_DARK = 8.0
"""Added to colours from 0 to 255 before logarithms: sensor noise must not look like light."""


@dataclass(frozen=True)
class SurfaceLightConfig:
    """What counts as a large surface, and how fast light changes along it."""

    least: float = 0.03
    """Smallest surface, as a share of the picture: larger than the things that are sought."""
    most: int = 8
    """Surfaces of a picture, at most."""
    near: float = 0.006
    """Distance from the plane, in normalised units, up to which a point is part of it."""
    smooth: float = 0.06
    """Standard deviation of the window in which light is the same, as a share of the width."""
    robust: float = 0.15
    """Logarithm of a colour ratio beyond which a pixel loses its say: it changed."""
    rounds: int = 4
    tries: int = 300
    """Planes through three points each, of which the one with most points is taken."""


def relit(view: View, shown: Render, config: SurfaceLightConfig) -> Render:
    """The render in the light of the picture: its exposure, and its light on large planes.

    Parameters
    ----------
    view : View
        The captured picture, from the same camera.
    """
    known = shown.known & ~view.ignore
    colour_map = fit_exposure(shown.image / 255.0, view.image / 255.0, known)
    exposed = shown.image / 255.0 @ colour_map[:, :3].T + colour_map[:, 3]
    image = np.rint(exposed.clip(0, 1) * 255).astype(np.uint8)
    with_depth = known & np.isfinite(shown.depth)
    points = np.nan_to_num(unproject(replace(view, depth=shown.depth)))
    for plane in large_planes(points, with_depth, config):
        image[plane] = _in_its_light(view.image, image, plane, config)[plane]
    return replace(shown, image=image)


def large_planes(
    points: Float[np.ndarray, "h w 3"], known: Bool[np.ndarray, "h w"], config: SurfaceLightConfig
) -> list[Bool[np.ndarray, "h w"]]:
    """Pixels of the planes that fill enough of the picture, the largest first.

    Parameters
    ----------
    points : array (h, w, 3)
        In normalised units.
    """
    rng = np.random.default_rng(0)
    left, planes = known.copy(), []
    while len(planes) < config.most and left.sum() >= config.least * known.size:
        cloud = points[left]
        some = cloud[rng.integers(0, len(cloud), 1500)]
        a, b, c = (cloud[rng.integers(0, len(cloud), config.tries)] for _ in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        offsets = np.sum(normals * a, axis=1)
        inside = np.abs(some @ normals.T - offsets) < config.near
        inside &= np.abs(normals).any(axis=1)  # three points on a line hold no plane
        best = int(inside.sum(axis=0).argmax())
        plane = left & (np.abs(points @ normals[best] - offsets[best]) < config.near)
        if plane.sum() < config.least * known.size or not normals[best].any():
            break
        left &= ~plane
        opened = cv2.morphologyEx(plane.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        planes.append(opened > 0)
    return planes


def _in_its_light(
    captured: UInt8[np.ndarray, "h w 3"],
    rendered: UInt8[np.ndarray, "h w 3"],
    plane: Bool[np.ndarray, "h w"],
    config: SurfaceLightConfig,
) -> UInt8[np.ndarray, "h w 3"]:
    """The render times the smooth ratio of both pictures over one plane."""
    logs = np.log(rendered.astype(np.float32) + _DARK)
    ratio = np.log(captured.astype(np.float32) + _DARK) - logs
    sigma = max(config.smooth * plane.shape[1], 1.0)
    weight = plane.astype(np.float32)
    light = np.zeros_like(ratio)
    for _ in range(config.rounds):
        light = _weighted_blur(ratio, weight, sigma)
        error = np.abs(ratio - light).mean(axis=-1)
        weight = plane / (1 + (error / np.float32(config.robust)) ** 2)
    return np.rint((np.exp(logs + light) - _DARK).clip(0, 255)).astype(np.uint8)


def _weighted_blur(
    values: Float32[np.ndarray, "h w c"], weight: Float32[np.ndarray, "h w"], sigma: float
) -> Float32[np.ndarray, "h w c"]:
    total = cv2.GaussianBlur(weight, (0, 0), sigma)
    sums = cv2.GaussianBlur(values * weight[..., None], (0, 0), sigma)
    return (sums / (total + np.float32(1e-4))[..., None]).astype(np.float32)
