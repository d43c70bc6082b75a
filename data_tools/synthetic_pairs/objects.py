"""Object families of the demonstration, `tiny` and `val` scenes.

Each family is a function of a shape generator and a paint box.
"""

import numpy as np

from data_tools.synthetic_pairs.canvas import Rng
from data_tools.synthetic_pairs.meshes import (
    Mesh,
    arc,
    box,
    box_front_back,
    box_lids,
    box_sides,
    cylinder,
    disc,
    grid,
    join,
    lathe,
    sphere,
    tube,
)
from data_tools.synthetic_pairs.models import Builder, Model, Paint, Part

# --- on a table ---------------------------------------------------------------------------------


def carton(rng: Rng, paint: Paint) -> Model:
    """A cereal box: a cover in front and behind, print on the sides."""
    x, y, z = rng.uniform(0.16, 0.22), rng.uniform(0.06, 0.09), rng.uniform(0.24, 0.32)
    front, side = paint.cover(), paint.printed()
    return Model(
        "carton",
        (
            Part(box_front_back(x, y, z), front),
            Part(join([box_sides(x, y, z), box_lids(x, y, z)]), side),
        ),
    )


def mug(rng: Rng, paint: Paint) -> Model:
    """A mug with a handle."""
    r, h = rng.uniform(0.05, 0.062), rng.uniform(0.11, 0.14)
    profile = [
        (0.0, 0.0),
        (r * 0.9, 0.0),
        (r, 0.006),
        (r, h),
        (r - 0.005, h),
        (r - 0.006, 0.01),
        (0.0, 0.01),
    ]
    handle = tube(arc(0.042, h * 0.34, -np.pi / 2, np.pi / 2), 0.008)
    handle = handle.moved((r - 0.004, 0.0, h * 0.52))
    material = paint.printed(0.6)
    return Model("mug", (Part(lathe(profile), material), Part(handle, material)))


def bottle(rng: Rng, paint: Paint) -> Model:
    """A bottle with a label and a cap."""
    r, h = rng.uniform(0.045, 0.06), rng.uniform(0.27, 0.34)
    neck = r * 0.35
    body = [
        (0.0, 0.0),
        (r, 0.0),
        (r, h * 0.58),
        (r * 0.85, h * 0.68),
        (neck, h * 0.8),
        (neck, h * 0.92),
    ]
    cap = [(neck * 1.2, h * 0.9), (neck * 1.2, h), (0.0, h)]
    wrap = cylinder(r * 1.012, h * 0.34).moved((0, 0, h * 0.15))
    return Model(
        "bottle",
        (
            Part(lathe(body), paint.bright(0.8)),
            Part(wrap, paint.printed()),
            Part(lathe(cap, 24), paint.bright()),
        ),
    )


def books(rng: Rng, paint: Paint) -> Model:
    """A stack of two to four books."""
    parts, z = [], 0.0
    for _ in range(int(rng.integers(2, 5))):
        x, y, t = rng.uniform(0.19, 0.25), rng.uniform(0.14, 0.18), rng.uniform(0.025, 0.045)
        yaw, place = rng.uniform(-0.3, 0.3), (0.0, 0.0, z)
        parts.append(Part(box_lids(x, y, t).moved(place, yaw), paint.cover()))
        parts.append(Part(box_sides(x, y, t).moved(place, yaw), paint.plain((0.92, 0.90, 0.83))))
        parts.append(Part(box_front_back(x, y, t).moved(place, yaw), paint.printed()))
        z += t
    return Model("books", tuple(parts))


def ball(rng: Rng, paint: Paint) -> Model:
    """A patterned ball."""
    return Model("ball", (Part(sphere(rng.uniform(0.08, 0.12)), paint.printed(0.35)),))


def bowl(rng: Rng, paint: Paint) -> Model:
    """An open bowl, sometimes with fruit in it."""
    r = rng.uniform(0.10, 0.14)
    angle = np.linspace(0.25, np.pi / 2, 9)
    outside = [(0.0, 0.0), (r * 0.45, 0.0), (r * 0.45, 0.01)]
    outside += [(r * np.sin(a), 0.01 + r * 0.75 * (1 - np.cos(a))) for a in angle]
    top = outside[-1][1]
    inside = [(0.94 * r * np.sin(a), 0.02 + (top - 0.02) * (1 - np.cos(a))) for a in angle[::-1]]
    material = paint.printed(0.6)
    parts = [Part(lathe([*outside, *inside, (0.0, 0.02)]), material)]
    if rng.uniform() < 0.6:
        fruit = paint.bright(0.3)
        for k in range(3):
            a = 2.1 * k + rng.uniform(0, 0.5)
            place = (0.4 * r * np.cos(a), 0.4 * r * np.sin(a), top * 0.45)
            parts.append(Part(sphere(0.034, 24).moved(place), fruit))
    return Model("bowl", tuple(parts))


def desk_lamp(rng: Rng, paint: Paint) -> Model:
    """A table lamp: foot, rod and a cloth shade."""
    h, r = rng.uniform(0.36, 0.46), rng.uniform(0.10, 0.13)
    foot = lathe([(0.085, 0.0), (0.085, 0.015), (0.02, 0.03), (0.012, 0.03), (0.012, h * 0.7)], 28)
    shade = lathe([(r, h * 0.58), (r * 0.68, h)])
    lining = lathe([(r * 0.67, h - 0.004), (r * 0.99, h * 0.58)])
    return Model(
        "lamp",
        (
            Part(foot, paint.metal()),
            Part(shade, paint.printed(0.0)),
            Part(lining, paint.plain((0.95, 0.9, 0.8))),
        ),
    )


def potted_plant(rng: Rng, paint: Paint) -> Model:
    """A pot with a tuft of bent leaves."""
    r, h = rng.uniform(0.07, 0.09), rng.uniform(0.11, 0.15)
    pot = lathe([(0.0, 0.0), (r * 0.72, 0.0), (r, h), (r * 0.92, h), (r * 0.9, h * 0.85)])
    soil = disc(r * 0.93, h * 0.85)
    leaves = []
    for k in range(16):
        length, lean = rng.uniform(0.14, 0.24), rng.uniform(0.25, 1.0)
        blade = _leaf(length, rng.uniform(0.014, 0.024), lean)
        leaves.append(blade.moved((0, 0, h * 0.84), yaw=2.4 * k + rng.uniform(0, 0.6)))
    green = paint.plain((0.22 + 0.1 * rng.uniform(), 0.45, 0.2), 0.2)
    return Model(
        "plant",
        (
            Part(pot, paint.printed()),
            Part(soil, paint.plain((0.25, 0.18, 0.13), 0.0)),
            Part(join(leaves), green),
        ),
    )


def _leaf(length: float, width: float, lean: float) -> Mesh:
    s = np.linspace(0, 1, 8)
    bend = lean * (0.4 + 0.8 * s)
    x = np.cumsum(np.sin(bend)) * length / 8 + 0.01
    z = np.cumsum(np.cos(bend)) * length / 8
    half = width * np.sin(np.pi * np.clip(0.1 + 0.9 * s, 0, 1))
    rows = [np.stack([x, side * half, z + 0.3 * half], axis=-1) for side in (-1.0, 0.0, 1.0)]
    rows[1][:, 2] -= 0.3 * half
    normal = np.stack([-np.cos(bend), np.zeros(8), np.sin(bend)], axis=-1)
    return grid(np.stack(rows), np.stack([normal] * 3), s, np.array([0.0, 0.5, 1.0]))


# --- on the floor -------------------------------------------------------------------------------


def stool(rng: Rng, paint: Paint) -> Model:
    """A round stool on four splayed legs."""
    r, h = rng.uniform(0.16, 0.19), rng.uniform(0.42, 0.50)
    seat = [
        Part(lathe([(0.0, h - 0.05), (r, h - 0.05), (r, h)]), paint.bright()),
        Part(disc(r, h), paint.printed()),
    ]
    legs = []
    for k in range(4):
        c, s = np.cos(np.pi / 4 + k * np.pi / 2), np.sin(np.pi / 4 + k * np.pi / 2)
        ends = np.array([[c * r * 1.05, s * r * 1.05, 0.012], [c * r * 0.6, s * r * 0.6, h - 0.04]])
        legs.append(tube(ends, 0.016))
    return Model("stool", (*seat, Part(join(legs), paint.wood())))


def waste_bin(rng: Rng, paint: Paint) -> Model:
    """An open bin, wider at the top."""
    r, h = rng.uniform(0.13, 0.16), rng.uniform(0.30, 0.38)
    wall = lathe([(0.0, 0.0), (r * 0.8, 0.0), (r, h)])
    inner = lathe([(r, h), (r * 0.97, h), (r * 0.78, 0.01), (0.0, 0.01)])
    return Model("bin", (Part(wall, paint.printed(0.3)), Part(inner, paint.metal())))


def parcel(rng: Rng, paint: Paint) -> Model:
    """A cardboard box with tape and a label."""
    x, y, z = rng.uniform(0.28, 0.42), rng.uniform(0.26, 0.34), rng.uniform(0.2, 0.32)
    tape = box(x * 1.004, 0.05, z * 1.004)
    note = box(x * 0.45, y * 1.008, z * 0.5).moved((x * 0.1, 0, z * 0.3))
    return Model(
        "parcel",
        (
            Part(box(x, y, z), paint.plain((0.70, 0.55, 0.38), 0.05)),
            Part(tape, paint.plain((0.80, 0.72, 0.55), 0.4)),
            Part(note, paint.cover()),
        ),
    )


def floor_cushion(rng: Rng, paint: Paint) -> Model:
    """A thick round cushion."""
    r = rng.uniform(0.2, 0.26)
    return Model("cushion", (Part(sphere(r).stretched(1.0, 1.0, 0.38), paint.printed(0.0)),))


TABLE: tuple[Builder, ...] = (carton, mug, bottle, books, ball, bowl, desk_lamp, potted_plant)
FLOOR: tuple[Builder, ...] = (stool, waste_bin, parcel, floor_cushion)
