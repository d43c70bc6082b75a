"""An empty room: shell, furniture, what may stand where, and what to look at."""

from dataclasses import dataclass

import numpy as np

from data_tools.synthetic_pairs.canvas import Rng, hex_colours, pick
from data_tools.synthetic_pairs.meshes import Mesh, box, box_front_back, join, quad, sheet
from data_tools.synthetic_pairs.models import Material, Model, Paint, Part
from data_tools.synthetic_pairs.prints import outdoors
from data_tools.synthetic_pairs.styles import Style

CEILING = 2.6
SHELL_TILE = 4.0
"""Metres of floor or wall that one texture covers."""
FRAMES = hex_colours("e9e6de 6b4a30 2e2f33 b59468")
CURTAINS = hex_colours("a8b5a2 c4a98a 8fa3b5 b89a9a d8d0c0")


@dataclass(frozen=True)
class Support:
    """A level rectangle that things may stand on."""

    name: str
    x: tuple[float, float]
    y: tuple[float, float]
    z: float
    headroom: float


@dataclass(frozen=True, eq=False)
class Room:
    """Walls and furniture; the camera side is at y = 0, the wall that it faces at y = `depth`."""

    shell: Model
    furniture: tuple[Model, ...]
    tops: tuple[Support, ...]
    """Table, sideboard and shelf."""
    floors: tuple[Support, ...]
    width: float
    depth: float
    table: tuple[float, float, float]
    """Centre of the table top."""
    window: tuple[float, float, float, float]
    """On a side wall: x of the wall, y from, y to, z from; it is as high as `WINDOW_HEIGHT`."""


WINDOW_HEIGHT = 1.25


def build_room(rng: Rng, style: Style, texture_size: int) -> Room:
    """A furnished room; the generator decides sizes, sides and materials.

    Parameters
    ----------
    texture_size : int
        Side of the wall and floor textures in pixels (a power of two); those of the furniture
        are a quarter of it.
    """
    width, depth = rng.uniform(5.2, 5.8), rng.uniform(4.6, 5.0)
    side = 1.0 if rng.uniform() < 0.5 else -1.0
    paint = Paint(rng, style.prints, style.covers, style.woods, texture_size // 4)
    table_x, table_y = side * rng.uniform(0.15, 0.35), depth - rng.uniform(0.95, 1.1)
    size = (rng.uniform(1.35, 1.6), rng.uniform(0.8, 0.9))
    top = rng.uniform(0.70, 0.76)
    board_x = -side * rng.uniform(1.45, 1.55)
    board = (rng.uniform(0.9, 1.05), 0.42, rng.uniform(0.6, 0.75))
    shelf_x, shelf_z = board_x + side * 0.1, rng.uniform(1.25, 1.35)
    wall_x = side * width / 2
    window = (wall_x, depth - 2.5, depth - 1.1, 0.95)
    furniture = (
        _table(paint, *size, top).moved(table_x, table_y, 0, 0),
        _sideboard(paint, *board).moved(board_x, depth - board[1] / 2 - 0.02, 0, 0),
        _shelf(paint).moved(shelf_x, depth - 0.14, shelf_z, 0),
        _rug(rng, style, texture_size // 4).moved(
            table_x, table_y - 1.0, 0, rng.uniform(-0.05, 0.05)
        ),
        *_posters(rng, style, texture_size // 4, table_x, depth, side, wall_x),
        _window(rng, texture_size // 4, window),
        _curtain(paint, window),
    )
    tops = (
        Support("table", _span(table_x, size[0]), _span(table_y, size[1]), top, 0.8),
        Support(
            "sideboard",
            _span(board_x, board[0]),
            _span(depth - 0.23, board[1]),
            board[2],
            shelf_z - board[2] - 0.05,
        ),
        Support("shelf", _span(shelf_x, 1.1), _span(depth - 0.14, 0.26), shelf_z + 0.03, 0.5),
    )
    floors = (
        Support("rug", _span(table_x, 2.0), (table_y - 1.35, table_y - 0.55), 0.008, 0.6),
        Support("beside the sideboard", _span(board_x, 1.1), (depth - 1.15, depth - 0.5), 0, 1.0),
        Support(
            "beside the table",
            _span(side * (width / 2 - 0.55), 0.9),
            (depth - 1.2, depth - 0.25),
            0,
            1.0,
        ),
    )
    shell = _shell(rng, style, width, depth, texture_size)
    return Room(shell, furniture, tops, floors, width, depth, (table_x, table_y, top), window)


def _span(centre: float, length: float) -> tuple[float, float]:
    return centre - length / 2, centre + length / 2


def _bare(rng: Rng) -> Paint:
    """For plain colours only."""
    return Paint(rng, (), (), (), 64)


def _metric(mesh: Mesh, wide: float, high: float) -> Mesh:
    """Texture at its true size; a negative width mirrors it, so that no two walls look alike."""
    return mesh.tiled(wide / SHELL_TILE, high / SHELL_TILE)


def _shell(rng: Rng, style: Style, width: float, depth: float, size: int) -> Model:
    x, c = width / 2, CEILING
    floor = Material(style.floors[int(rng.integers(len(style.floors)))](rng, size), 0.12)
    family = style.walls[int(rng.integers(len(style.walls)))]
    wall = Material(family(rng, size), 0.02)
    white = _bare(rng).plain((0.93, 0.93, 0.91), 0.0)
    left = quad((-x, 0, 0), (0, depth, 0), (0, 0, c))
    right = quad((x, depth, 0), (0, -depth, 0), (0, 0, c))
    skirting = [
        box(width, 0.02, 0.09).moved((0, depth - 0.01, 0)),
        box(0.02, depth, 0.09).moved((-x + 0.01, depth / 2, 0)),
        box(0.02, depth, 0.09).moved((x - 0.01, depth / 2, 0)),
    ]
    return Model(
        "room",
        (
            Part(_metric(quad((-x, 0, 0), (width, 0, 0), (0, depth, 0)), width, depth), floor),
            Part(_metric(quad((-x, depth, 0), (width, 0, 0), (0, 0, c)), width, c), wall),
            Part(_metric(join([left, right]), -depth, c), wall),
            Part(_metric(quad((x, 0, 0), (-width, 0, 0), (0, 0, c)), -width, c), wall),
            Part(quad((-x, 0, c), (0, depth, 0), (width, 0, 0)), white),
            Part(join(skirting), white),
        ),
    )


def _table(paint: Paint, x: float, y: float, z: float) -> Model:
    wood = paint.wood()
    legs = [
        box(0.06, 0.06, z - 0.04).moved((sx * (x / 2 - 0.06), sy * (y / 2 - 0.06), 0))
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    apron = [box(x - 0.16, 0.02, 0.08).moved((0, sy * (y / 2 - 0.06), z - 0.12)) for sy in (-1, 1)]
    return Model(
        "table",
        (
            Part(box(x, y, 0.04).moved((0, 0, z - 0.04)), wood),
            Part(join([*legs, *apron]), wood),
        ),
    )


def _sideboard(paint: Paint, x: float, y: float, z: float) -> Model:
    body, door, knob = paint.wood(), paint.wood(), paint.metal()
    doors = [
        box(x * 0.46, 0.02, z * 0.82).moved((sx * x * 0.24, -y / 2 - 0.008, z * 0.1))
        for sx in (-1, 1)
    ]
    knobs = [box(0.025, 0.03, 0.09).moved((sx * 0.05, -y / 2 - 0.03, z * 0.5)) for sx in (-1, 1)]
    return Model(
        "sideboard",
        (
            Part(box(x, y, z), body),
            Part(join(doors), door),
            Part(join(knobs), knob),
        ),
    )


def _shelf(paint: Paint) -> Model:
    brackets = [box(0.03, 0.2, 0.05).moved((x, 0.02, -0.05)) for x in (-0.4, 0.4)]
    return Model(
        "shelf",
        (
            Part(box(1.1, 0.26, 0.03), paint.wood()),
            Part(join(brackets), paint.metal()),
        ),
    )


def _rug(rng: Rng, style: Style, size: int) -> Model:
    cloth = Material(style.rugs[int(rng.integers(len(style.rugs)))](rng, size), 0.0)
    return Model("rug", (Part(box(2.2, 1.35, 0.008), cloth),))


def _posters(
    rng: Rng, style: Style, size: int, table_x: float, depth: float, side: float, wall_x: float
) -> tuple[Model, ...]:
    back = [(table_x - 0.32, depth - 0.01, 0.0), (table_x + 0.45, depth - 0.01, 0.0)]
    spots = [
        *back,
        (-wall_x + side * 0.01, depth - 1.4, np.pi / 2),
        (-wall_x + side * 0.01, depth - 2.6, np.pi / 2),
    ]
    posters = []
    for x, y, yaw in spots:
        wide, high = rng.uniform(0.42, 0.58), rng.uniform(0.55, 0.72)
        print_ = Material(style.posters[int(rng.integers(len(style.posters)))](rng, size), 0.1)
        frame = _bare(rng).plain(pick(rng, FRAMES), 0.3)
        poster = Model(
            "poster",
            (
                Part(box(wide + 0.05, 0.02, high + 0.05), frame),
                Part(box_front_back(wide, 0.024, high).moved((0, 0, 0.025)), print_),
            ),
        )
        posters.append(poster.moved(x, y, rng.uniform(1.2, 1.4), yaw))
    return tuple(posters)


def _window(rng: Rng, size: int, window: tuple[float, float, float, float]) -> Model:
    x, y0, y1, z0 = window
    inward, wide, high = -np.sign(x), y1 - y0, WINDOW_HEIGHT
    view = Material(outdoors(rng, size), 0.0, glow=1.0)
    white = _bare(rng).plain((0.92, 0.92, 0.90), 0.2)
    bars = [box(0.07, wide + 0.14, 0.07).moved((0, 0, z)) for z in (-0.07, high)]
    bars += [box(0.07, 0.07, high).moved((0, y, 0)) for y in (-wide / 2 - 0.035, wide / 2 + 0.035)]
    bars += [
        box(0.05, 0.04, high),
        box(0.04, wide, 0.035).moved((0, 0, high * 0.62)),
        box(0.2, wide + 0.2, 0.035).moved((inward * 0.08, 0, -0.1)),
    ]
    middle = (x + inward * 0.01, (y0 + y1) / 2, z0)
    pane = quad((x + inward * 0.012, y0, z0), (0, wide, 0), (0, 0, high))
    return Model("window", (Part(pane, view), Part(join(bars).moved(middle), white)))


def _curtain(paint: Paint, window: tuple[float, float, float, float]) -> Model:
    x, y0, y1, z0 = window
    inward = -np.sign(x)
    cloth = [
        sheet(0.42, WINDOW_HEIGHT + 0.75, 0.03, 5).moved((x + inward * 0.13, y, 0.3), np.pi / 2)
        for y in (y0 - 0.2, y1 + 0.2)
    ]
    rod = box(0.025, y1 - y0 + 0.9, 0.025).moved((x + inward * 0.13, (y0 + y1) / 2, z0 + 1.37))
    dye = paint.plain(pick(paint.rng, CURTAINS), 0.0)
    return Model("curtain", (Part(join(cloth).tiled(3, 12), dye), Part(rod, paint.metal())))
