"""A tiny analytic scene for tests: a textured back wall with textured cards floating before it.

Rays meet planes in closed form, so depth is exact and every pixel's truth is known.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from scenediff_classic.cameras import pixel_centres
from scenediff_classic.types import Geometry, Lens, SparsePoints, Video, View


@dataclass(frozen=True)
class Card:
    """An upright rectangle facing the cameras: lower corner, size, and its texture's seed."""

    x: float
    y: float
    z: float
    width: float
    height: float
    seed: int


WALL = Card(-4.0, -4.0, 3.0, 8.0, 8.0, 0)


def texture(seed: int) -> np.ndarray:
    """256 x 256 RGB picture: soft blotches and dots over a base colour, by seed."""
    rng = np.random.default_rng(seed)
    hue, value = (seed * 47) % 180, (120, 220)[seed % 2]
    colour = cv2.cvtColor(np.uint8([[[hue, 60 if seed == 0 else 170, value]]]), cv2.COLOR_HSV2RGB)
    base = colour[0, 0].astype(float)
    coarse = cv2.resize(rng.normal(0, 1, (16, 16)), (256, 256), interpolation=cv2.INTER_CUBIC)
    picture = base + 10 * coarse[..., None]
    for x, y in rng.integers(10, 246, (25 if seed == 0 else 8, 2)):
        cv2.circle(picture, (int(x), int(y)), int(rng.integers(4, 12)), (base * 0.7).tolist(), -1)
    return np.clip(picture, 0, 255).astype(np.uint8)


def render(
    cards: list[Card],
    video: Video,
    index: int,
    centre: tuple[float, float, float],
    width: int = 120,
    height: int = 90,
    focal: float = 110.0,
) -> View:
    """View along +z from `centre`; the nearest card on each ray is seen."""
    cam_from_world = np.eye(4)
    cam_from_world[:3, 3] = -np.asarray(centre)
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    rays = (pixel_centres(height, width) - [width / 2, height / 2]) / focal
    depth = np.full((height, width), np.nan, np.float32)
    image = np.zeros((height, width, 3), np.uint8)
    for card in sorted([WALL, *cards], key=lambda c: -c.z):
        z = card.z - centre[2]
        u = (rays[..., 0] * z + centre[0] - card.x) / card.width
        v = (rays[..., 1] * z + centre[1] - card.y) / card.height
        hit = (u >= 0) & (u < 1) & (v >= 0) & (v < 1)
        tiles = 3 if card is WALL else 1
        maps = [((c * tiles % 1) * 255).astype(np.float32) for c in (u, v)]
        seen = cv2.remap(texture(card.seed), *maps, cv2.INTER_LINEAR)
        image[hit], depth[hit] = seen[hit], z
    lens = Lens(width, height, intrinsics, np.zeros(4))
    return View(
        video,
        index,
        f"{video}/{index}",
        image,
        intrinsics,
        cam_from_world,
        depth,
        np.ones((height, width), np.float32),
        np.isfinite(depth),
        np.zeros((height, width), bool),
        lens,
    )


BEFORE_CENTRES = [(-0.30, 0.0, 0.0), (0.0, 0.1, 0.0), (0.3, 0.0, 0.05)]
AFTER_CENTRES = [(-0.2, -0.1, 0.05), (0.1, -0.05, 0.0), (0.35, 0.1, 0.0)]


def scene(before: list[Card], after: list[Card]) -> Geometry:
    """Three views of each state from different places."""
    views = [render(before, "before", k, c) for k, c in enumerate(BEFORE_CENTRES)]
    views += [render(after, "after", k, c) for k, c in enumerate(AFTER_CENTRES)]
    return Geometry(tuple(views), SparsePoints.none())


VASE = Card(-0.5, -0.3, 2.2, 0.45, 0.5, 11)
BOOK = Card(0.35, 0.0, 2.4, 0.4, 0.5, 12)
BOOK_ELSEWHERE = Card(0.0, -0.7, 2.4, 0.4, 0.5, 12)
CLOCK = Card(0.4, -0.6, 2.6, 0.4, 0.4, 13)
