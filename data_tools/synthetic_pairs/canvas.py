"""A small painter on float pictures, for floors, walls and printed matter."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from data_tools.synthetic_pairs import noise

Colour = tuple[float, float, float]
"""sRGB, 0 to 1."""
Rng = np.random.Generator


class Canvas:
    """A square picture in [0, 1] with coordinates that run from 0 to 1, y downwards."""

    def __init__(self, size: int, colour: Colour) -> None:
        self.size = size
        self.pixels = np.empty((size, size, 3), np.float32)
        self.pixels[:] = colour
        ramp = (np.arange(size, dtype=np.float32) + np.float32(0.5)) * np.float32(1 / size)
        self.x = np.broadcast_to(ramp[None, :], (size, size))
        self.y = np.broadcast_to(ramp[:, None], (size, size))

    def fill(self, mask: Bool[np.ndarray, "s s"], colour: Colour, opacity: float = 1.0) -> None:
        """Paint where `mask` holds."""
        paint = np.asarray(colour, np.float32)
        self.pixels[mask] += np.float32(opacity) * (paint - self.pixels[mask])

    def blend(self, weight: Float32[np.ndarray, "s s"], colour: Colour) -> None:
        """Paint with an opacity for every pixel."""
        paint = np.asarray(colour, np.float32)
        self.pixels += weight[..., None].astype(np.float32) * (paint - self.pixels)

    def shade(self, factor: np.ndarray) -> None:
        """Multiply every pixel."""
        self.pixels *= np.asarray(factor, np.float32)[..., None]

    def rectangle(self, x: float, y: float, width: float, height: float, colour: Colour) -> None:
        """Paint a filled rectangle given by its top-left corner."""
        s = self.size
        rows = slice(max(int(y * s), 0), max(int((y + height) * s), 0))
        columns = slice(max(int(x * s), 0), max(int((x + width) * s), 0))
        self.pixels[rows, columns] = colour

    def disc(self, x: float, y: float, radius: float, colour: Colour) -> None:
        """Paint a filled circle."""
        self.fill((self.x - x) ** 2 + (self.y - y) ** 2 < radius**2, colour)

    def glyphs(
        self, x: float, y: float, width: float, height: float, rows: int, colour: Colour, rng: Rng
    ) -> None:
        """Paint lines of made-up letters: from a distance they look like print."""
        line = height / rows
        cell = line * 0.62
        for row in range(rows):
            column = 0
            ends = width * rng.uniform(0.6, 1.0)
            while (column + 1) * cell < ends:
                if rng.uniform() > 0.15:
                    self._glyph(x + column * cell, y + row * line, cell, line, colour, rng)
                column += 1

    def _glyph(
        self, x: float, y: float, cell: float, line: float, colour: Colour, rng: Rng
    ) -> None:
        dots = rng.integers(0, 100, (5, 3)) < 62
        for r, c in zip(*np.nonzero(dots), strict=True):
            self.rectangle(
                x + c * cell / 4, y + r * line / 7, cell / 4 + 1e-4, line / 7 + 1e-4, colour
            )

    def finish(self, seed: int, grain: float = 0.05) -> UInt8[np.ndarray, "s s 3"]:
        """The picture in 8 bits, with a fine grain over it that gives every surface detail."""
        cells = max(self.size // 16, 1)
        texture = noise.fbm(self.size, self.size, cells, cells, seed, octaves=4, gain=0.75)
        self.shade(1.0 + np.float32(2.0 * grain) * (texture - np.float32(0.5)))
        return np.clip(np.rint(self.pixels * np.float32(255)), 0, 255).astype(np.uint8)


def tint(colour: Colour, factor: float) -> Colour:
    """A darker (factor < 1) or lighter colour."""
    r, g, b = (min(max(c * factor, 0.0), 1.0) for c in colour)
    return r, g, b


def mix(a: Colour, b: Colour, t: float) -> Colour:
    """The colour at `t` of the way from `a` to `b`."""
    return (a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t)


def pick(rng: Rng, colours: Sequence[Colour]) -> Colour:
    """One of the colours, a little lighter or darker."""
    return tint(colours[int(rng.integers(len(colours)))], rng.uniform(0.9, 1.1))


def hex_colours(text: str) -> tuple[Colour, ...]:
    """Colours from 'rrggbb rrggbb ...'."""
    return tuple(
        (int(c[:2], 16) / 255, int(c[2:4], 16) / 255, int(c[4:], 16) / 255) for c in text.split()
    )
