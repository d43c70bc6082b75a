"""A small textured room with exact depth: boxes ray-cast analytically in NumPy."""

import numpy as np
from scipy.ndimage import map_coordinates

from scenediff_classic.types import Geometry, Lens, SparsePoints, Video, View

BOXES = np.array(
    [
        [[-2.0, -1.5, -1.0], [2.0, 1.0, 4.0]],  # the room itself, seen from inside
        [[-0.9, 0.2, 2.0], [-0.2, 1.0, 2.6]],
        [[0.3, -0.2, 2.4], [0.9, 1.0, 3.0]],
        [[-0.2, 0.6, 1.6], [0.25, 1.0, 2.0]],
    ]
)
"""(minimum, maximum) corner of each box; y points down, so the floor is at y = 1."""


def _hits(origin: np.ndarray, rays: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Distance along each ray (n, 3) to the nearest surface."""
    with np.errstate(divide="ignore"):
        slabs = (boxes[:, :, None, :] - origin) / rays
    near = slabs.min(axis=1).max(axis=-1)
    far = slabs.max(axis=1).min(axis=-1)
    outside = np.where((near[1:] < far[1:]) & (near[1:] > 0), near[1:], np.inf)
    return np.minimum(far[0], outside.min(axis=0))


def _texture(points: np.ndarray, seed: int) -> np.ndarray:
    """Solid noise of four octaves at world points (n, 3): the same colour from everywhere."""
    rng = np.random.default_rng(seed)
    colour = np.zeros((len(points), 3))
    for octave in range(4):
        lattice = rng.uniform(-1, 1, (3, 24, 24, 24))
        where = (points * 4 * 2**octave).T
        for channel in range(3):
            value = map_coordinates(lattice[channel], where, order=1, mode="grid-wrap")
            colour[:, channel] += value / 1.4**octave
    return np.clip(128 + 70 * colour, 0, 255)


def look_at(centre: np.ndarray, target: np.ndarray) -> np.ndarray:
    """cam_from_world of an upright camera (world y points down)."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ centre
    return pose


def render(
    cam_from_world: np.ndarray,
    intrinsics: np.ndarray,
    height: int,
    width: int,
    *,
    seed: int = 0,
    noise: float = 1.5,
    boxes: np.ndarray = BOXES,
) -> tuple[np.ndarray, np.ndarray]:
    """Picture (uint8, 2x2 samples a pixel) and exact z-depth at the pixel centres."""
    rotation, centre = cam_from_world[:3, :3], -cam_from_world[:3, :3].T @ cam_from_world[:3, 3]

    def cast(offset_x: float, offset_y: float) -> tuple[np.ndarray, np.ndarray]:
        x, y = np.meshgrid(np.arange(width) + offset_x, np.arange(height) + offset_y)
        pixels = np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
        rays = (rotation.T @ np.linalg.inv(intrinsics) @ pixels).T
        depth = _hits(centre, rays, boxes)
        return depth, centre + rays * depth[:, None]

    depth, _ = cast(0.5, 0.5)
    corners = [(0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75)]
    colour = np.mean([_texture(cast(*c)[1], seed) for c in corners], axis=0)
    grain = np.random.default_rng([seed, height, width]).normal(0, noise, colour.shape)
    image = np.clip(np.rint(colour + grain), 0, 255).astype(np.uint8)
    return image.reshape(height, width, 3), depth.reshape(height, width).astype(np.float32)


def room(
    height: int = 90,
    width: int = 120,
    count: int = 5,
    *,
    video: Video = "before",
    scale: float = 1.0,
    boxes: np.ndarray = BOXES,
) -> tuple[Geometry, tuple[np.ndarray, ...]]:
    """Geometry of `count` views on an arc, without depth, and the true depth of each.

    `scale` stretches the world; the sparse points are true surface points.
    """
    intrinsics = np.array([[0.85 * width, 0, width / 2], [0, 0.85 * width, height / 2], [0, 0, 1]])
    lens = Lens(width, height, intrinsics, np.zeros(4))
    views, depths = [], []
    for i in range(count):
        angle = 0.12 * (i - (count - 1) / 2)
        centre = np.array(
            [2.4 * np.sin(angle), -0.25 + 0.06 * (-1) ** i, 2.3 - 2.4 * np.cos(angle)]
        )
        pose = look_at(centre, np.array([0.0, 0.2, 2.3]))
        image, depth = render(pose, intrinsics, height, width, boxes=boxes)
        pose[:3, 3] *= scale
        depths.append(depth * np.float32(scale))
        views.append(
            View(
                video=video, index=i, name=f"{i:03d}.png", image=image, intrinsics=intrinsics,
                cam_from_world=pose, depth=np.full((height, width), np.nan, np.float32),
                confidence=np.zeros((height, width), np.float32),
                measured=np.zeros((height, width), bool), ignore=np.zeros((height, width), bool),
                lens=lens,
            )
        )  # fmt: skip
    return Geometry(tuple(views), _points(views, depths)), tuple(depths)


def _points(views: list[View], depths: list[np.ndarray]) -> SparsePoints:
    """A sparse grid of the middle view's surface, observed wherever it is in sight."""
    middle = len(views) // 2
    height, width = depths[middle].shape
    rows, cols = (a.ravel() for a in np.mgrid[4:height:9, 4:width:9])
    K, pose = views[middle].intrinsics, views[middle].cam_from_world
    pixels = np.stack([cols + 0.5, rows + 0.5, np.ones(len(rows))])
    in_cam = (np.linalg.inv(K) @ pixels).T * depths[middle][rows, cols, None].astype(np.float64)
    xyz = (in_cam - pose[:3, 3]) @ pose[:3, :3]
    observations = []
    for i, view in enumerate(views):
        cam = xyz @ view.cam_from_world[:3, :3].T + view.cam_from_world[:3, 3]
        xy = (cam @ K.T)[:, :2] / cam[:, 2:]
        ok = (cam[:, 2] > 0) & (xy >= 0).all(1) & (xy[:, 0] < width) & (xy[:, 1] < height)
        column, row = np.where(ok, xy.T.astype(int), 0)
        ok &= np.abs(depths[i][row, column] / np.where(ok, cam[:, 2], 1) - 1) < 0.02
        observations += [(p, i) for p in np.flatnonzero(ok)]
    rgb = views[middle].image[rows, cols]
    return SparsePoints(xyz, rgb, np.array(observations, np.int64).reshape(-1, 2))
