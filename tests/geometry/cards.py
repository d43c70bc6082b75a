"""A room of textured rectangles, painted back to front: quick to draw, with known cameras."""

from pathlib import Path

import cv2
import numpy as np

from scenediff_classic.types import Capture, Frame, Video

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0
INTRINSICS = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
TEXELS = 512

# corner, edge along the texture's x, edge along its y; metres, y points down
RECTANGLES = [
    ([-3, -2.2, 5.0], [6, 0, 0], [0, 3.4, 0]),  # back wall
    ([-3, 1.2, 0.4], [6, 0, 0], [0, 0, 4.6]),  # floor
    ([-2.2, -1.6, 4.0], [1.6, 0, 0.3], [0, 1.8, 0]),
    ([0.6, -1.4, 3.7], [1.5, 0, -0.4], [0, 2.0, 0]),
    ([-1.1, 0.1, 3.2], [0.9, 0, 0.2], [0, 1.1, 0]),
    ([-0.1, 0.3, 2.7], [0.8, 0, -0.2], [0, 0.9, 0]),
]


def texture(seed: int, finest: int) -> np.ndarray:
    """Coloured noise of several octaves; `finest` = cells along a side of the last one."""
    rng = np.random.default_rng(seed)
    out = np.full((TEXELS, TEXELS, 3), 128.0)
    for cells in (finest // 9, finest // 3, finest):
        noise = rng.normal(0, 40, (cells, cells, 3))
        out += cv2.resize(noise, (TEXELS, TEXELS), interpolation=cv2.INTER_CUBIC)
    return np.clip(out, 0, 255).astype(np.uint8)


def look(centre: tuple[float, float, float], turn: float = 0.0) -> np.ndarray:
    """cam_from_world of an upright camera that looks along +z, turned by `turn` radians."""
    c, s = np.cos(turn), np.sin(turn)
    pose = np.eye(4)
    pose[:3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    pose[:3, 3] = -pose[:3, :3] @ np.array(centre)
    return pose


def sweep(count: int, y: float = 0.0, z: float = 0.2) -> list[np.ndarray]:
    """Cameras side by side, turned inwards."""
    return [look((x, y, z + 0.1 * np.cos(9 * x)), -0.22 * x) for x in np.linspace(-0.9, 0.9, count)]


def draw(cam_from_world: np.ndarray, seed: int = 0) -> np.ndarray:
    """The picture of a camera; `seed` chooses all textures."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    for number, (corner, along, down) in enumerate(RECTANGLES):
        plane = np.eye(4, 3)
        plane[:3] = np.stack([along, down, corner], axis=1)
        plane[3] = [0, 0, 1]
        texel = np.array([[1 / TEXELS, 0, 0.5 / TEXELS], [0, 1 / TEXELS, 0.5 / TEXELS], [0, 0, 1]])
        shift = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
        h = shift @ INTRINSICS @ cam_from_world[:3] @ plane @ texel
        painted = texture(100 * seed + number, 70 if number < 2 else 30)
        layer = cv2.warpPerspective(painted, h, (WIDTH, HEIGHT))
        solid = np.full((TEXELS, TEXELS), 255, np.uint8)
        cover = cv2.warpPerspective(solid, h, (WIDTH, HEIGHT)) > 127
        image[cover] = layer[cover]
    return image


def capture(video: Video, poses: list[np.ndarray], seed: int = 0) -> Capture:
    """Frames of the given cameras."""
    frames = tuple(
        Frame(video, index, f"{video}{index}.png", None, draw(pose, seed), WIDTH, HEIGHT)
        for index, pose in enumerate(poses)
    )
    return Capture(video, f"{video} folder", frames)


def similarity_residual(estimated: np.ndarray, true: np.ndarray) -> float:
    """RMS distance of points (n, 3) after the best similarity, as a fraction of their spread."""
    a, b = estimated - estimated.mean(0), true - true.mean(0)
    u, s, vt = np.linalg.svd(a.T @ b)
    flip = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    aligned = (s * np.diag(flip)).sum() / (a**2).sum() * a @ u @ flip @ vt
    return float(np.sqrt(((aligned - b) ** 2).sum(1).mean() / (b**2).sum(1).mean()))


def files_in(folder: Path) -> dict[str, int]:
    """Modification time of every file below a folder."""
    return {str(p.relative_to(folder)): p.stat().st_mtime_ns for p in folder.rglob("*")}
