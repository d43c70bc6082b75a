"""The regular grid that features live on, and the steps that all of them share."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Float32, Float64


def cell_centres(length: int, stride: int) -> Float64[np.ndarray, "n"]:
    """Centres of ceil(length / stride) equal cells, as continuous pixel coordinates."""
    count = -(-length // stride)
    return (np.arange(count) + 0.5) * (length / count)


def cell_grid(
    shape: tuple[int, int], stride: int
) -> tuple[Float64[np.ndarray, "h w"], Float64[np.ndarray, "h w"]]:
    """Continuous pixel x and y of the centre of every cell of a picture of (height, width)."""
    x, y = np.meshgrid(cell_centres(shape[1], stride), cell_centres(shape[0], stride))
    return x, y


def sampled_at(
    channels: Sequence[Float[np.ndarray, "H W"]],
    x: Float[np.ndarray, "h w"],
    y: Float[np.ndarray, "h w"],
) -> Float[np.ndarray, "h w c"]:
    """Channels at continuous pixel positions; beyond its border a picture is mirrored."""
    maps = (x - 0.5).astype(np.float32), (y - 0.5).astype(np.float32)
    return np.stack(
        [cv2.remap(c, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT) for c in channels],
        axis=-1,
    )


def unit(vectors: Float[np.ndarray, "*n c"]) -> Float32[np.ndarray, "*n c"]:
    """Vectors scaled to length 1."""
    length = np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-8)
    return (vectors / length).astype(np.float32)


def width_factor(shape: tuple[int, int]) -> float:
    """Pixels of a picture of (height, width) per pixel of one whose long side is 512."""
    return max(shape) / 512
