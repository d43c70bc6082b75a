"""Seeded noise from integer hashes, so that textures come out alike on every machine.

Only 32-bit integer mixing and plain float32 sums and products are used: no random state, no
library call whose order of summation depends on the processor.
"""

import zlib

import numpy as np
from jaxtyping import Float32, UInt32


def seed_of(*parts: int | str) -> int:
    """One 32-bit seed from several numbers or names; order matters."""
    return zlib.crc32("/".join(str(part) for part in parts).encode())


def scramble(values: UInt32[np.ndarray, "*n"], seed: int) -> UInt32[np.ndarray, "*n"]:
    """Well mixed 32-bit integers: two rounds of xor-shift and odd multiplication."""
    x = np.atleast_1d(values.astype(np.uint32)) + np.uint32((seed * 0x9E3779B1) & 0xFFFFFFFF)
    x = (x ^ (x >> np.uint32(16))) * np.uint32(0x7FEB352D)
    x = (x ^ (x >> np.uint32(15))) * np.uint32(0x846CA68B)
    x = x ^ (x >> np.uint32(16))
    return x.reshape(values.shape)


def uniform(values: UInt32[np.ndarray, "*n"], seed: int) -> Float32[np.ndarray, "*n"]:
    """Numbers in [0, 1), one for each integer."""
    return (scramble(values, seed) >> np.uint32(8)).astype(np.float32) * np.float32(2.0**-24)


def bell(values: UInt32[np.ndarray, "*n"], seed: int) -> Float32[np.ndarray, "*n"]:
    """Nearly normal numbers (mean 0, variance 1): four 8-bit uniforms out of one hash."""
    bits = scramble(values, seed)
    total = np.zeros(bits.shape, np.float32)
    for shift in (0, 8, 16, 24):
        total += ((bits >> np.uint32(shift)) & np.uint32(255)).astype(np.float32)
    return (total - np.float32(510.0)) * np.float32(1.0 / 147.8)


def lattice(rows: int, columns: int, seed: int) -> Float32[np.ndarray, "rows columns"]:
    """Independent values in [0, 1)."""
    index = np.arange(rows * columns, dtype=np.uint32).reshape(rows, columns)
    return uniform(index, seed)


def value_noise(
    height: int, width: int, cells_y: int, cells_x: int, seed: int
) -> Float32[np.ndarray, "height width"]:
    """Smooth noise in [0, 1) that tiles: a random lattice, interpolated."""
    grid = lattice(cells_y, cells_x, seed)
    top, wy = _weights(height, cells_y)
    left, wx = _weights(width, cells_x)
    across = _lerp(grid[:, left], grid[:, (left + 1) % cells_x], wx[None, :])
    return _lerp(across[top], across[(top + 1) % cells_y], wy[:, None])


def fbm(
    height: int,
    width: int,
    cells_y: int,
    cells_x: int,
    seed: int,
    octaves: int = 5,
    gain: float = 0.5,
) -> Float32[np.ndarray, "height width"]:
    """Fractal noise in [0, 1): octaves of `value_noise`, each finer and fainter."""
    total = np.zeros((height, width), np.float32)
    weight, norm = 1.0, 0.0
    for octave in range(octaves):
        fine_y, fine_x = min(cells_y << octave, height), min(cells_x << octave, width)
        total += np.float32(weight) * value_noise(height, width, fine_y, fine_x, seed + octave)
        norm += weight
        weight *= gain
    return total * np.float32(1.0 / norm)


def _weights(pixels: int, cells: int) -> tuple[np.ndarray, np.ndarray]:
    position = (np.arange(pixels, dtype=np.float32) + np.float32(0.5)) * np.float32(cells / pixels)
    cell = np.floor(position)
    t = position - cell
    return cell.astype(np.int64) % cells, t * t * (np.float32(3.0) - np.float32(2.0) * t)


def _lerp(a: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    return a + (b - a) * t
