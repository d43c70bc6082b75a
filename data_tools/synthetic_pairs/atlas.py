"""All textures of a scene in one array, with coarser levels against aliasing."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Int64, UInt8


class Atlas:
    """Looks up many textures at once.

    Parameters
    ----------
    textures : sequence of pyramids
        Each as `pyramid` makes it.
    """

    def __init__(self, textures: Sequence[Sequence[np.ndarray]]) -> None:
        self.levels = max(len(levels) for levels in textures)
        self.sizes = np.ones((len(textures), self.levels), np.int64)
        self.starts = np.zeros((len(textures), self.levels), np.int64)
        chunks, total = [], 0
        for k, levels in enumerate(textures):
            for level, picture in enumerate(levels):
                self.sizes[k, level] = picture.shape[0]
                self.starts[k, level] = total
                chunks.append(picture.reshape(-1, 3))
                total += len(chunks[-1])
            # Nothing is coarser than one texel: use it again.
            self.starts[k, len(levels) :] = self.starts[k, len(levels) - 1]
        self.texels = np.concatenate(chunks)

    def look_up(
        self,
        texture: Int64[np.ndarray, "n"],
        uv: Float32[np.ndarray, "n 2"],
        footprint: Float32[np.ndarray, "n"],
    ) -> Float32[np.ndarray, "n 3"]:
        """Linear-light colour at texture coordinates.

        Parameters
        ----------
        footprint : array (n,)
            Side of the pixel on the surface, in texture coordinates (1 = the whole texture).
        """
        texels_wide = footprint * self.sizes[texture, 0].astype(np.float32)
        level = np.clip(np.log2(np.maximum(texels_wide, 1)), 0, np.float32(self.levels - 1.001))
        fine = level.astype(np.int64)
        t = (level - fine.astype(np.float32))[:, None]
        a = self._bilinear(texture, uv, fine)
        return a + (self._bilinear(texture, uv, fine + 1) - a) * t

    def _bilinear(self, texture: np.ndarray, uv: np.ndarray, level: np.ndarray) -> np.ndarray:
        size, start = self.sizes[texture, level], self.starts[texture, level]
        wide = size.astype(np.float32)
        x = uv[:, 0] * wide - np.float32(0.5)
        y = (1 - uv[:, 1]) * wide - np.float32(0.5)
        left, top = np.floor(x), np.floor(y)
        wx, wy = (x - left)[:, None], (y - top)[:, None]
        mask = size - 1  # a power of two less one: wraps round
        x0 = left.astype(np.int64) & mask
        y0 = (top.astype(np.int64) & mask) * size + start
        x1 = (x0 + 1) & mask
        y1 = ((top.astype(np.int64) + 1) & mask) * size + start
        texels = self.texels
        upper = texels[y0 + x0] * (1 - wx) + texels[y0 + x1] * wx
        lower = texels[y1 + x0] * (1 - wx) + texels[y1 + x1] * wx
        return upper * (1 - wy) + lower * wy


def pyramid(texture: UInt8[np.ndarray, "s s 3"]) -> tuple[Float32[np.ndarray, "_ _ 3"], ...]:
    """Linear-light copies of a texture, each half as large as the one before, down to one texel.

    Raises
    ------
    ValueError
        If the texture is not square with a power of two a side.
    """
    size = texture.shape[0]
    if texture.shape[1] != size or size & (size - 1):
        raise ValueError(f"a texture must be square with a power of two a side: {texture.shape}")
    steps = np.arange(256) / 255.0
    table = np.where(steps <= 0.04045, steps / 12.92, ((steps + 0.055) / 1.055) ** 2.4)
    levels: list[np.ndarray] = [table.astype(np.float32)[texture]]
    while levels[-1].shape[0] > 1:
        fine = levels[-1]
        pairs = fine[::2] + fine[1::2]
        levels.append(np.float32(0.25) * (pairs[:, ::2] + pairs[:, 1::2]))
    return tuple(levels)
