"""Pairs for the 2D network out of single pictures: things pasted into one of two copies, either of
which is then turned, shifted and stretched by itself."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from baselines.cyws.pairs import LEAST_PIXELS, TwoViews, jittered_colour
from baselines.cyws.scenes import SceneFrames

TURN, SHIFT, STRETCH = 30.0, 0.2, (0.8, 1.5)
"""Degrees, share of the side, factors of either axis: the largest changes, as published."""


def cut_paste_pair(
    scenes: Sequence[SceneFrames], rng: np.random.Generator, strength: float = 1.0
) -> TwoViews:
    """A frame beside itself, with up to three patches of other frames pasted into one of the two.

    Parameters
    ----------
    strength : float
        How much the copies are moved: 0 = not at all, 1 = as published.
    """
    base = _some_frame(scenes, rng)
    height, width = base.shape[:2]
    copies, patches = [base.copy(), base.copy()], []
    for _ in range(int(rng.integers(0, 4))):
        mask = blob(height, width, rng)
        copies[int(rng.integers(2))][mask] = _some_frame(scenes, rng)[mask]
        patches.append(mask)
    moves = [_random_affine(height, width, rng, strength) for _ in range(2)]
    images = np.stack(
        [
            jittered_colour(_warped(copy, move, cv2.BORDER_REPLICATE), rng)
            for copy, move in zip(copies, moves, strict=True)
        ]
    )
    to_unit = np.diag([1 / width, 1 / height, 1.0])
    across = to_unit @ moves[1] @ np.linalg.inv(to_unit @ moves[0])
    still = np.stack([np.eye(4)] * 2)
    return TwoViews(
        images,
        np.ones((2, height, width), np.float32),
        still[:, :3, :3].copy(),
        still,
        labels(patches, moves[0], moves[1]),
        across[:2],
    )


def labels(
    patches: Sequence[Bool[np.ndarray, "h w"]],
    first: Float64[np.ndarray, "3 3"],
    second: Float64[np.ndarray, "3 3"],
) -> Float32[np.ndarray, "n 2 4"]:
    """Boxes, in either copy, of the part of each patch that both still show.

    Parameters
    ----------
    first, second : array (3, 3)
        Where pixels (centres at one half) of the unmoved picture come to lie in either copy.
    """
    boxes = []
    for patch in patches:
        common = patch.copy()
        height, width = patch.shape
        rows, columns = np.nonzero(patch)
        for move in (first, second):
            x, y = move[:2, :2] @ np.stack([columns + 0.5, rows + 0.5]) + move[:2, 2:]
            outside = (x < 0) | (x >= width) | (y < 0) | (y >= height)
            common[rows[outside], columns[outside]] = False
        seen = [
            _warped(common.astype(np.uint8), m, cv2.BORDER_CONSTANT) > 0 for m in (first, second)
        ]
        if all(s.sum() >= LEAST_PIXELS for s in seen):
            boxes.append([_bounds(s) for s in seen])
    return np.array(boxes, np.float32).reshape(-1, 2, 4)


def blob(height: int, width: int, rng: np.random.Generator) -> Bool[np.ndarray, "h w"]:
    """A patch with a wavy outline, a tenth to a third of the picture's shorter side across."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    waves = sum(
        rng.uniform(0, 0.25 / k) * np.sin(k * angle + rng.uniform(0, 2 * np.pi)) for k in (1, 2, 3)
    )
    side = min(height, width) * rng.uniform(0.05, 0.17)
    stretch = np.exp(rng.uniform(-0.4, 0.4))
    x = rng.uniform(0.1, 0.9) * width + side * stretch * (1 + waves) * np.cos(angle)
    y = rng.uniform(0.1, 0.9) * height + side / stretch * (1 + waves) * np.sin(angle)
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.stack([x, y], 1).round().astype(np.int32)], 1)
    return mask > 0


def _some_frame(
    scenes: Sequence[SceneFrames], rng: np.random.Generator
) -> UInt8[np.ndarray, "h w 3"]:
    images = scenes[int(rng.integers(len(scenes)))].images
    return images[int(rng.integers(len(images)))]


def _random_affine(
    height: int, width: int, rng: np.random.Generator, strength: float
) -> Float64[np.ndarray, "3 3"]:
    angle = np.radians(rng.uniform(-TURN, TURN) * strength)
    stretch = np.exp(strength * rng.uniform(np.log(STRETCH[0]), np.log(STRETCH[1]), 2))
    c, s = np.cos(angle), np.sin(angle)
    middle = np.array([width, height]) / 2
    out = np.eye(3)
    out[:2, :2] = np.array([[c, -s], [s, c]]) * stretch
    shift = rng.uniform(-SHIFT, SHIFT, 2) * strength * [width, height]
    out[:2, 2] = middle - out[:2, :2] @ middle + shift
    return out


def _warped(image: np.ndarray, move: Float64[np.ndarray, "3 3"], border: int) -> np.ndarray:
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV's centres are whole numbers
    matrix = (np.linalg.inv(half) @ move @ half)[:2]
    flags = cv2.INTER_NEAREST if image.ndim == 2 else cv2.INTER_LINEAR
    size = (image.shape[1], image.shape[0])
    return cv2.warpAffine(image, matrix, size, flags=flags, borderMode=border)


def _bounds(mask: Bool[np.ndarray, "h w"]) -> tuple[int, int, int, int]:
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
