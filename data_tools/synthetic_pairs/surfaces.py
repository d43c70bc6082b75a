"""Textures of floors, walls, furniture and rugs.

Every family is a function of a random generator and a size in pixels. The pictures tile.
"""

import itertools
from collections.abc import Callable

import numpy as np
from jaxtyping import UInt8

from data_tools.synthetic_pairs import noise
from data_tools.synthetic_pairs.canvas import Canvas, Colour, Rng, hex_colours, mix, pick, tint

Texture = UInt8[np.ndarray, "s s 3"]
Family = Callable[[Rng, int], np.ndarray]
"""(generator, side in pixels) -> square RGB picture."""

WOODS = hex_colours("a97c50 8a5a35 b98d5f 7a4f30 c09a6b 9a6b45")
STONES = hex_colours("b9b4aa a7a49c c4bdb0 9c9a98 cfc8bb")
PAINTS = hex_colours("e4ddcf d5dcd8 d9d3c4 cfd8df e6dccb d7d9c7")
CLOTHS = hex_colours("8c3b3b 3a5a78 56694b 7a6248 6c4a6e a8743c 2f5d62")


def _seed(rng: Rng) -> int:
    return int(rng.integers(2**31))


def _grain(canvas: Canvas, rng: Rng, strength: float, along_x: bool = True) -> None:
    """Fibres: noise that is long one way and short the other, bent by slow noise."""
    s, seed = canvas.size, _seed(rng)
    cells = (s // 8, 4) if along_x else (4, s // 8)
    fibre = noise.fbm(s, s, *cells, seed, octaves=4, gain=0.7)
    cloud = noise.fbm(s, s, 6, 6, seed + 50, octaves=4)
    canvas.shade(1.0 + strength * (1.6 * (fibre - 0.5) + 0.8 * (cloud - 0.5)))
    knots = noise.fbm(s, s, 24, 10, seed + 90, octaves=2)
    canvas.shade(1.0 - strength * 1.4 * np.clip(knots - 0.74, 0, 1) / 0.26)


def planks(rng: Rng, size: int) -> np.ndarray:
    """Floor boards of uneven length, each with its own tone."""
    base = pick(rng, WOODS)
    canvas = Canvas(size, base)
    rows = 26
    seed = _seed(rng)
    for row in range(rows):
        shift, x = rng.uniform(0, 0.3), 0.0
        joints = [0.0, *np.cumsum(rng.uniform(0.18, 0.4, 4)), 1.0]
        for a, b in itertools.pairwise(joints):
            tone = tint(mix(base, pick(rng, WOODS), 0.25), rng.uniform(0.82, 1.12))
            canvas.rectangle((a + shift) % 1.0, row / rows, min(b, 1.0) - a, 1 / rows, tone)
            x = (a + shift) % 1.0
            canvas.rectangle(x, row / rows, 2.5 / size, 1 / rows, tint(base, 0.4))
        canvas.rectangle(0, row / rows, 1, 2.5 / size, tint(base, 0.4))
    _grain(canvas, rng, 0.30)
    return canvas.finish(seed, 0.10)


def herringbone(rng: Rng, size: int) -> np.ndarray:
    """Parquet in zigzag blocks."""
    base = pick(rng, WOODS)
    canvas = Canvas(size, base)
    n = 24
    across = canvas.x * n
    zigzag = np.abs((across % 4) - 2)
    along = canvas.y * n + zigzag * 2
    block = np.floor(along / 2) % n + n * np.floor(across / 2)
    tone = noise.uniform(block.astype(np.uint32), _seed(rng))
    canvas.shade(0.78 + 0.4 * tone)
    canvas.fill((along % 2 < 0.09) | (across % 2 < 0.07), tint(base, 0.42))
    _grain(canvas, rng, 0.22, along_x=False)
    return canvas.finish(_seed(rng), 0.10)


def tiles(rng: Rng, size: int) -> np.ndarray:
    """Stone tiles with grout lines and veins."""
    base = pick(rng, STONES)
    canvas = Canvas(size, base)
    n, s = 10, size
    cell = np.floor(canvas.x * n) + n * np.floor(canvas.y * n)
    canvas.shade(0.84 + 0.26 * noise.uniform(cell.astype(np.uint32), _seed(rng)))
    cloud = noise.fbm(s, s, 8, 8, _seed(rng), octaves=6, gain=0.6)
    canvas.shade(0.80 + 0.4 * cloud)
    vein = np.abs(noise.fbm(s, s, 10, 10, _seed(rng), octaves=5) - 0.5)
    canvas.blend(np.clip(0.02 - vein, 0, 1) * 22, tint(base, 0.55))
    grout = (canvas.x * n % 1 < 0.02) | (canvas.y * n % 1 < 0.02)
    canvas.fill(grout, tint(base, 0.5))
    return canvas.finish(_seed(rng), 0.10)


def terrazzo(rng: Rng, size: int) -> np.ndarray:
    """Stone chips of several colours in light cement."""
    canvas = Canvas(size, pick(rng, STONES))
    s = size
    chips = hex_colours("7c4a3a 4f5a60 d8cfc0 96714f 2f3436 b58f6f")
    for colour in chips:
        blobs = noise.fbm(s, s, s // 14, s // 14, _seed(rng), octaves=2)
        canvas.fill(blobs > 0.69, tint(colour, rng.uniform(0.85, 1.15)))
    canvas.shade(0.9 + 0.2 * noise.fbm(s, s, 5, 5, _seed(rng), octaves=4))
    return canvas.finish(_seed(rng), 0.08)


def concrete(rng: Rng, size: int) -> np.ndarray:
    """Cement with stains and pores."""
    canvas = Canvas(size, pick(rng, hex_colours("9c9a95 8d8f90 a8a297")))
    s = size
    canvas.shade(0.68 + 0.64 * noise.fbm(s, s, 6, 6, _seed(rng), octaves=8, gain=0.66))
    pores = noise.fbm(s, s, s // 10, s // 10, _seed(rng), octaves=2)
    canvas.blend(np.clip(pores - 0.76, 0, 1) * 3.5, (0.2, 0.2, 0.2))
    return canvas.finish(_seed(rng), 0.10)


def carpet(rng: Rng, size: int) -> np.ndarray:
    """Short pile with flecks of a second colour."""
    base = pick(rng, hex_colours("6f7479 7d6f60 5d6a66 85796f"))
    canvas = Canvas(size, base)
    s = size
    canvas.shade(0.84 + 0.32 * noise.fbm(s, s, 7, 7, _seed(rng), octaves=5, gain=0.6))
    flecks = noise.fbm(s, s, s // 6, s // 6, _seed(rng), octaves=2)
    canvas.blend(np.clip(flecks - 0.6, 0, 1) * 2.6, tint(base, 1.7))
    canvas.blend(np.clip(0.34 - flecks, 0, 1) * 3.0, tint(base, 0.4))
    return canvas.finish(_seed(rng), 0.16)


def plaster(rng: Rng, size: int) -> np.ndarray:
    """Painted plaster: roller marks, faint clouds, a few scuffs."""
    canvas = Canvas(size, pick(rng, PAINTS))
    s = size
    canvas.shade(0.93 + 0.14 * noise.fbm(s, s, 5, 5, _seed(rng), octaves=6, gain=0.62))
    bumps = noise.fbm(s, s, s // 14, s // 14, _seed(rng), octaves=3, gain=0.6)
    canvas.shade(0.92 + 0.16 * bumps)
    scuffs = noise.fbm(s, s, 60, 24, _seed(rng), octaves=3)
    canvas.blend(np.clip(scuffs - 0.74, 0, 1) * 1.6, (0.35, 0.33, 0.30))
    return canvas.finish(_seed(rng), 0.06)


def striped_paper(rng: Rng, size: int) -> np.ndarray:
    """Wallpaper with soft vertical stripes of uneven width."""
    base = pick(rng, PAINTS)
    canvas = Canvas(size, base)
    stripe = pick(rng, hex_colours("b9c3b4 c7b8a3 aebccb cdb4a8"))
    x = 0.0
    while x < 1.0:
        width = rng.uniform(0.012, 0.03)
        canvas.rectangle(x, 0, width, 1, mix(base, stripe, rng.uniform(0.45, 0.95)))
        canvas.rectangle(x + width, 0, 0.0022, 1, tint(stripe, 0.7))
        x += width + rng.uniform(0.012, 0.03)
    s = size
    canvas.shade(0.92 + 0.16 * noise.fbm(s, s, 6, 6, _seed(rng), octaves=7, gain=0.68))
    return canvas.finish(_seed(rng), 0.08)


def panelling(rng: Rng, size: int) -> np.ndarray:
    """Painted boards, upright, with grooves and brush marks."""
    base = pick(rng, hex_colours("c9d0cb d6cdbd b8c4cc d8d3c8"))
    canvas = Canvas(size, base)
    n = 28
    tone = noise.lattice(1, n, _seed(rng))[0]
    canvas.shade(0.93 + 0.12 * tone[np.minimum((canvas.x * n).astype(int), n - 1)])
    canvas.fill(canvas.x * n % 1 < 0.045, tint(base, 0.55))
    canvas.fill((canvas.x * n % 1 > 0.045) & (canvas.x * n % 1 < 0.09), tint(base, 1.1))
    _grain(canvas, rng, 0.14, along_x=False)
    return canvas.finish(_seed(rng), 0.08)


def brick(rng: Rng, size: int) -> np.ndarray:
    """Brickwork under a thin coat of paint."""
    base = pick(rng, hex_colours("b98a73 c9b7a2 a8776a d3c8b8"))
    canvas = Canvas(size, base)
    rows, columns = 52, 17
    y = canvas.y * rows
    x = canvas.x * columns + 0.5 * (np.floor(y) % 2)
    cell = np.floor(x) % columns + columns * np.floor(y)
    canvas.shade(0.76 + 0.36 * noise.uniform(cell.astype(np.uint32), _seed(rng)))
    canvas.fill((y % 1 < 0.11) | (x % 1 < 0.04), tint(mix(base, (0.8, 0.8, 0.78), 0.5), 0.85))
    s = size
    canvas.shade(0.8 + 0.4 * noise.fbm(s, s, 12, 12, _seed(rng), octaves=7, gain=0.7))
    return canvas.finish(_seed(rng), 0.12)


def stucco(rng: Rng, size: int) -> np.ndarray:
    """Rough render: strong small bumps, lit from one side."""
    canvas = Canvas(size, pick(rng, hex_colours("ddd2c0 d2d6d2 e0d6cc c9ccd2")))
    s = size
    bumps = noise.fbm(s, s, s // 24, s // 24, _seed(rng), octaves=4, gain=0.6)
    canvas.shade(1.0 + 1.9 * (bumps - np.roll(bumps, (2, 2), (0, 1))))
    canvas.shade(0.93 + 0.14 * noise.fbm(s, s, 5, 5, _seed(rng), octaves=5))
    return canvas.finish(_seed(rng), 0.06)


def dotted_paper(rng: Rng, size: int) -> np.ndarray:
    """Wallpaper with a printed motif that varies from place to place."""
    base = pick(rng, PAINTS)
    canvas = Canvas(size, base)
    ink = pick(rng, hex_colours("8fa39a a58d7d 8893a6 b39a78"))
    n = 44
    y = canvas.y * n
    x = canvas.x * n + 0.5 * (np.floor(y) % 2)
    cell = (np.floor(x) % n + n * np.floor(y)).astype(np.uint32)
    radius = 0.16 + 0.16 * noise.uniform(cell, _seed(rng))
    away = np.sqrt((x % 1 - 0.5) ** 2 + (y % 1 - 0.5) ** 2)
    canvas.fill(away < radius, ink)
    canvas.fill(away < radius * noise.uniform(cell, _seed(rng)), base)
    s = size
    canvas.shade(0.92 + 0.16 * noise.fbm(s, s, 6, 6, _seed(rng), octaves=7, gain=0.66))
    return canvas.finish(_seed(rng), 0.06)


def walnut(rng: Rng, size: int) -> np.ndarray:
    """Solid wood in wide staves."""
    base = pick(rng, WOODS)
    canvas = Canvas(size, base)
    n = 6
    tone = noise.lattice(1, n, _seed(rng))[0]
    canvas.shade(0.86 + 0.26 * tone[np.minimum((canvas.y * n).astype(int), n - 1)])
    canvas.fill(canvas.y * n % 1 < 0.012, tint(base, 0.5))
    _grain(canvas, rng, 0.42)
    return canvas.finish(_seed(rng), 0.10)


def worn_paint(rng: Rng, size: int) -> np.ndarray:
    """Painted wood, worn through in places."""
    paint = pick(rng, hex_colours("d9d4c8 a9b8b4 c8b9a0 9fb0bf"))
    canvas = Canvas(size, paint)
    s = size
    _grain(canvas, rng, 0.12)
    worn = noise.fbm(s, s, 20, 8, _seed(rng), octaves=6, gain=0.65)
    canvas.blend(np.clip((worn - 0.6) * 9, 0, 1) * 0.8, pick(rng, WOODS))
    return canvas.finish(_seed(rng), 0.08)


def marble(rng: Rng, size: int) -> np.ndarray:
    """Light stone with dark veins at several scales."""
    canvas = Canvas(size, pick(rng, hex_colours("e2dfd8 d6d3cf cfd2d0")))
    s = size
    canvas.shade(0.84 + 0.24 * noise.fbm(s, s, 5, 5, _seed(rng), octaves=6, gain=0.6))
    for cells, width in ((4, 0.035), (9, 0.03), (18, 0.025)):
        vein = np.abs(noise.fbm(s, s, cells, cells, _seed(rng), octaves=6, gain=0.6) - 0.5)
        canvas.blend(np.clip(1 - vein / width, 0, 1) * 0.42, (0.33, 0.32, 0.34))
    return canvas.finish(_seed(rng), 0.08)


def butcher_block(rng: Rng, size: int) -> np.ndarray:
    """Glued wooden blocks of many tones."""
    base = pick(rng, WOODS)
    canvas = Canvas(size, base)
    rows, columns = 18, 7
    y = canvas.y * rows
    row = np.floor(y)
    shift = noise.lattice(1, rows, _seed(rng))[0][np.minimum(row.astype(int), rows - 1)]
    x = canvas.x * columns + shift * columns
    cell = (np.floor(x) % columns + columns * row).astype(np.uint32)
    canvas.shade(0.72 + 0.5 * noise.uniform(cell, _seed(rng)))
    canvas.fill((x % 1 < 0.012) | (y % 1 < 0.03), tint(base, 0.5))
    _grain(canvas, rng, 0.3)
    return canvas.finish(_seed(rng), 0.10)


def diamond_rug(rng: Rng, size: int) -> np.ndarray:
    """A woven rug with a border and a field of diamonds."""
    field, ink, light = pick(rng, CLOTHS), pick(rng, CLOTHS), (0.86, 0.81, 0.70)
    canvas = Canvas(size, field)
    n = 7
    x, y = canvas.x * n, canvas.y * n
    away = np.abs(x % 1 - 0.5) + np.abs(y % 1 - 0.5)
    canvas.fill(away < 0.42, ink)
    canvas.fill(away < 0.28, light)
    canvas.fill(away < 0.14, field)
    _weave(canvas, rng, ink, light)
    return canvas.finish(_seed(rng), 0.14)


def striped_rug(rng: Rng, size: int) -> np.ndarray:
    """A flat-woven rug in bands, some of them toothed."""
    light: Colour = (0.85, 0.80, 0.71)
    canvas = Canvas(size, light)
    y = 0.0
    while y < 1.0:
        height = rng.uniform(0.02, 0.09)
        colour = pick(rng, (*CLOTHS, light))
        teeth = np.abs(canvas.x * 18 % 1 - 0.5) * rng.choice([0.0, 0.06])
        canvas.fill((canvas.y + teeth >= y) & (canvas.y < y + height), colour)
        y += height
    _weave(canvas, rng, pick(rng, CLOTHS), light)
    return canvas.finish(_seed(rng), 0.14)


def _weave(canvas: Canvas, rng: Rng, ink: Colour, light: Colour) -> None:
    edge = np.minimum(np.minimum(canvas.x, 1 - canvas.x), np.minimum(canvas.y, 1 - canvas.y))
    canvas.fill(edge < 0.075, light)
    canvas.fill(edge < 0.06, ink)
    canvas.fill(edge < 0.015, tint(ink, 0.6))
    s = canvas.size
    thread = noise.fbm(s, s, s // 3, s // 12, _seed(rng), octaves=1)
    canvas.shade(0.78 + 0.44 * thread)
    canvas.shade(0.82 + 0.36 * noise.fbm(s, s, 6, 6, _seed(rng), octaves=5, gain=0.6))
