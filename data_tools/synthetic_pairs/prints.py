"""Textures of objects, book covers, labels, posters and the view from the window."""

import numpy as np

from data_tools.synthetic_pairs import noise
from data_tools.synthetic_pairs.canvas import Canvas, Colour, Rng, hex_colours, mix, pick, tint

LIVELY = hex_colours(
    "c8483c e0913a e8c34a 5f9e5a 2f7f86 3c64a6 7a4f8f b8607a f0e8da 2d3138 8a5a3b d9e2e0"
)
PALE = hex_colours("f2ece0 e6edf0 f4e3d0 e9e6da")
DARK = hex_colours("23262b 2c3e50 4a2c2a 243b2f 3b2a4a")


def _seed(rng: Rng) -> int:
    return int(rng.integers(2**31))


def _ink_on(rng: Rng, ground: Colour) -> Colour:
    return pick(rng, PALE if sum(ground) < 1.4 else DARK)


def label(rng: Rng, size: int) -> np.ndarray:
    """A printed package: coloured ground, title, picture, small print; twice across."""
    ground = pick(rng, LIVELY)
    ink = _ink_on(rng, ground)
    canvas = Canvas(size, ground)
    band = pick(rng, LIVELY)
    y = rng.uniform(0.5, 0.7)
    canvas.rectangle(0, y, 1, rng.uniform(0.08, 0.2), band)
    for side in (0.0, 0.5):
        canvas.glyphs(side + 0.05, 0.08, 0.40, 0.16, 1, ink, rng)
        canvas.glyphs(side + 0.05, 0.28, 0.38, 0.14, 3, mix(ink, ground, 0.2), rng)
        for _ in range(4):
            spot = (side + rng.uniform(0.1, 0.4), rng.uniform(0.5, 0.8), rng.uniform(0.03, 0.1))
            canvas.disc(*spot, pick(rng, LIVELY))
        canvas.glyphs(side + 0.05, 0.86, 0.40, 0.10, 3, ink, rng)
    return canvas.finish(_seed(rng), 0.05)


def stripes(rng: Rng, size: int) -> np.ndarray:
    """Bands of several colours and widths."""
    canvas = Canvas(size, pick(rng, PALE))
    y = 0.0
    while y < 1.0:
        height = rng.uniform(0.02, 0.12)
        canvas.rectangle(0, y, 1, height, pick(rng, LIVELY))
        y += height + rng.uniform(0.0, 0.06)
    s = size
    canvas.shade(0.8 + 0.4 * noise.fbm(s, s, 16, 8, _seed(rng), octaves=5, gain=0.65))
    return canvas.finish(_seed(rng), 0.06)


def speckle(rng: Rng, size: int) -> np.ndarray:
    """Glazed stoneware: speckles and a dipped rim."""
    base = pick(rng, LIVELY)
    canvas = Canvas(size, base)
    s = size
    canvas.shade(0.85 + 0.3 * noise.fbm(s, s, 6, 6, _seed(rng), octaves=5))
    spots = noise.fbm(s, s, s // 8, s // 8, _seed(rng), octaves=2)
    canvas.blend(np.clip((spots - 0.66) * 12, 0, 1), tint(base, 0.35))
    dip = 0.25 + 0.12 * noise.fbm(s, s, 6, 6, _seed(rng), octaves=2)
    canvas.fill(canvas.y < dip, pick(rng, PALE))
    return canvas.finish(_seed(rng), 0.05)


def painted_leaves(rng: Rng, size: int) -> np.ndarray:
    """A hand-painted pattern of strokes."""
    ground = pick(rng, PALE)
    canvas = Canvas(size, ground)
    inks = [pick(rng, LIVELY) for _ in range(3)]
    for _ in range(60):
        x, y, angle = rng.uniform(0, 1), rng.uniform(0, 1), rng.uniform(0, np.pi)
        c, s = np.cos(angle), np.sin(angle)
        dx = (canvas.x - np.float32(x) + 0.5) % 1 - 0.5
        dy = canvas.y - np.float32(y)
        along, across = (
            dx * np.float32(c) + dy * np.float32(s),
            dy * np.float32(c) - dx * np.float32(s),
        )
        canvas.fill((along / 0.075) ** 2 + (across / 0.022) ** 2 < 1, inks[int(rng.integers(3))])
    return canvas.finish(_seed(rng), 0.06)


def checks(rng: Rng, size: int) -> np.ndarray:
    """Tartan: crossing bands."""
    canvas = Canvas(size, pick(rng, LIVELY))
    for _ in range(7):
        colour, at, width = pick(rng, LIVELY), rng.uniform(0, 1), rng.uniform(0.02, 0.09)
        for axis in (canvas.x, canvas.y):
            band = ((axis - np.float32(at)) % np.float32(0.5)) < width
            canvas.fill(band, colour, 0.55)
    return canvas.finish(_seed(rng), 0.10)


def zigzag(rng: Rng, size: int) -> np.ndarray:
    """Rows of chevrons in three colours, with worn print."""
    inks = [pick(rng, LIVELY), pick(rng, PALE), pick(rng, LIVELY), pick(rng, DARK)]
    canvas = Canvas(size, inks[0])
    phase = canvas.y * 9 + np.abs(canvas.x * 8 % 1 - 0.5) * 1.6
    for k in range(1, 4):
        canvas.fill((np.floor(phase) % 4) == k, inks[k])
    s = size
    canvas.shade(0.78 + 0.44 * noise.fbm(s, s, 10, 10, _seed(rng), octaves=6, gain=0.65))
    return canvas.finish(_seed(rng), 0.06)


def camouflage(rng: Rng, size: int) -> np.ndarray:
    """Blotches of four colours."""
    inks = [pick(rng, LIVELY) for _ in range(4)]
    canvas = Canvas(size, inks[0])
    s = size
    for k in (1, 2, 3):
        blot = noise.fbm(s, s, 5 + k, 5 + k, _seed(rng), octaves=4)
        canvas.fill(blot > 0.54 + 0.02 * k, inks[k])
    return canvas.finish(_seed(rng), 0.10)


def stamp(rng: Rng, size: int) -> np.ndarray:
    """A stencilled crate or tin: frame, rings, two lines of print."""
    ground = pick(rng, LIVELY)
    ink = _ink_on(rng, ground)
    canvas = Canvas(size, ground)
    s = size
    canvas.shade(0.72 + 0.5 * noise.fbm(s, s, 24, 6, _seed(rng), octaves=5, gain=0.7))
    edge = np.minimum(np.minimum(canvas.x, 1 - canvas.x), np.minimum(canvas.y, 1 - canvas.y))
    canvas.fill((edge > 0.04) & (edge < 0.07), ink)
    x = rng.uniform(0.3, 0.7)
    for radius in (0.19, 0.13, 0.08):
        canvas.disc(x, 0.36, radius, ink if radius != 0.13 else pick(rng, LIVELY))
    canvas.glyphs(0.12, 0.62, 0.76, 0.26, 2, ink, rng)
    return canvas.finish(_seed(rng), 0.08)


def cover(rng: Rng, size: int) -> np.ndarray:
    """A book cover: title, author, one bold figure."""
    ground = pick(rng, LIVELY)
    ink = _ink_on(rng, ground)
    canvas = Canvas(size, ground)
    for _ in range(int(rng.integers(3, 7))):
        canvas.disc(
            rng.uniform(0.1, 0.9),
            rng.uniform(0.35, 0.8),
            rng.uniform(0.05, 0.22),
            pick(rng, LIVELY),
        )
    canvas.rectangle(0, 0, 0.05, 1, tint(ground, 0.6))
    canvas.glyphs(0.12, 0.07, 0.8, 0.22, 2, ink, rng)
    canvas.glyphs(0.12, 0.87, 0.6, 0.08, 1, ink, rng)
    return canvas.finish(_seed(rng), 0.05)


def shapes_poster(rng: Rng, size: int) -> np.ndarray:
    """An abstract print: discs, bars and small type on pale paper."""
    canvas = Canvas(size, pick(rng, PALE))
    for _ in range(9):
        colour = pick(rng, LIVELY)
        if rng.uniform() < 0.5:
            canvas.disc(
                rng.uniform(0.15, 0.85), rng.uniform(0.15, 0.7), rng.uniform(0.04, 0.18), colour
            )
        else:
            canvas.rectangle(
                rng.uniform(0.1, 0.7),
                rng.uniform(0.1, 0.65),
                rng.uniform(0.04, 0.25),
                rng.uniform(0.03, 0.2),
                colour,
            )
    canvas.glyphs(0.1, 0.82, 0.8, 0.10, 3, pick(rng, DARK), rng)
    return _framed(canvas, rng)


def landscape_poster(rng: Rng, size: int) -> np.ndarray:
    """Layered hills under a sun, as a screen print."""
    canvas = Canvas(size, pick(rng, hex_colours("f3d9b1 cfe3ea f2c6a8 e8e2c8")))
    canvas.disc(rng.uniform(0.25, 0.75), rng.uniform(0.22, 0.38), 0.11, pick(rng, LIVELY))
    far, near = pick(rng, hex_colours("9fb7c4 b8a9c0 a9bf9f")), pick(rng, DARK)
    for k in range(6):
        ridge = noise.fbm(1, size, 1, 3 + k, _seed(rng), octaves=5)[0]
        height = 0.38 + 0.09 * k + 0.22 * (ridge - 0.5)
        canvas.fill(canvas.y > height[None, :], mix(far, near, k / 5))
    canvas.glyphs(0.12, 0.88, 0.76, 0.06, 1, pick(rng, PALE), rng)
    return _framed(canvas, rng)


def _framed(canvas: Canvas, rng: Rng) -> np.ndarray:
    edge = np.minimum(np.minimum(canvas.x, 1 - canvas.x), np.minimum(canvas.y, 1 - canvas.y))
    canvas.fill(edge < 0.06, (0.95, 0.94, 0.92))
    return canvas.finish(_seed(rng), 0.05)


def outdoors(rng: Rng, size: int) -> np.ndarray:
    """What is seen through the window: sky, far trees, a lawn; softly out of focus."""
    canvas = Canvas(size, (0.66, 0.80, 0.95))
    s = size
    canvas.blend(np.clip(canvas.y, 0, 1) * 0.6, (0.93, 0.95, 0.96))
    cloud = noise.fbm(s, s, 3, 3, _seed(rng), octaves=4)
    canvas.blend(np.clip((cloud - 0.5) * 3, 0, 1), (0.97, 0.97, 0.98))
    for k, colour in enumerate(hex_colours("8fae96 6f9468 55793f")):
        ridge = noise.fbm(1, s, 1, 5 + 3 * k, _seed(rng), octaves=4)[0]
        depth = np.clip((canvas.y - (0.5 + 0.12 * k + 0.2 * (ridge - 0.5))[None]) * 30, 0, 1)
        canvas.blend(depth, colour)
    return canvas.finish(_seed(rng), 0.03)


def glazed(rng: Rng, size: int) -> np.ndarray:
    """One colour with a faint grain: for the hard case without texture."""
    return Canvas(size, pick(rng, LIVELY)).finish(_seed(rng), 0.015)


def flat_paint(rng: Rng, size: int) -> np.ndarray:
    """A pale, almost even wall: for the hard case without texture."""
    canvas = Canvas(size, pick(rng, PALE))
    canvas.shade(0.98 + 0.04 * noise.fbm(size, size, 5, 5, _seed(rng), octaves=5))
    return canvas.finish(_seed(rng), 0.012)
