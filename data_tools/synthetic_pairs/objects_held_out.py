"""Object families of the `test` scenes, which share none with the others.

Each family is a function of a shape generator and a paint box.
"""

import numpy as np

from data_tools.synthetic_pairs.canvas import Rng
from data_tools.synthetic_pairs.meshes import (
    arc,
    box,
    box_front_back,
    cylinder,
    disc,
    join,
    lathe,
    sphere,
    tube,
)
from data_tools.synthetic_pairs.models import Builder, Model, Paint, Part

# --- on a table ---------------------------------------------------------------------------------


def tin(rng: Rng, paint: Paint) -> Model:
    """A preserve tin with a paper wrapper and ribbed metal ends."""
    r, h = rng.uniform(0.05, 0.075), rng.uniform(0.12, 0.2)
    rim = lathe([(r, 0.0), (r * 1.04, 0.004), (r, 0.008)])
    top = lathe(
        [
            (r * 1.04, h - 0.005),
            (r * 1.04, h),
            (r * 0.95, h),
            (r * 0.93, h - 0.006),
            (0.0, h - 0.006),
        ]
    )
    return Model(
        "tin", (Part(cylinder(r, h), paint.printed(0.3)), Part(join([rim, top]), paint.metal()))
    )


def teapot(rng: Rng, paint: Paint) -> Model:
    """A round pot with spout, handle, lid and knob."""
    r = rng.uniform(0.075, 0.095)
    body = sphere(r).stretched(1, 1, 0.85)
    h = 2 * r * 0.85
    knob = sphere(r * 0.16, 20).moved((0, 0, h * 0.97))
    spout = tube(
        np.array([[r * 0.8, 0, h * 0.35], [r * 1.25, 0, h * 0.55], [r * 1.6, 0, h * 0.9]]), r * 0.14
    )
    handle = tube(arc(r * 0.6, h * 0.32, np.pi / 2, 3 * np.pi / 2), r * 0.1)
    glaze = paint.printed(0.7)
    return Model(
        "teapot",
        (
            Part(body, glaze),
            Part(join([spout, handle.moved((-r * 0.85, 0, h * 0.52))]), glaze),
            Part(knob, paint.bright()),
        ),
    )


def jar(rng: Rng, paint: Paint) -> Model:
    """A storage jar with a wooden lid."""
    r, h = rng.uniform(0.06, 0.08), rng.uniform(0.15, 0.22)
    body = lathe([(0.0, 0.0), (r * 0.9, 0.0), (r, h * 0.12), (r, h * 0.75), (r * 0.8, h * 0.86)])
    lid = lathe([(r * 0.86, h * 0.86), (r * 0.86, h), (0.0, h)])
    return Model("jar", (Part(body, paint.printed(0.5)), Part(lid, paint.wood())))


def vase(rng: Rng, paint: Paint) -> Model:
    """A vase with a curved outline."""
    r, h = rng.uniform(0.06, 0.09), rng.uniform(0.24, 0.34)
    t = np.linspace(0, 1, 20)
    waist = rng.uniform(0.8, 1.4)
    radii = r * (0.55 + 0.45 * np.sin(np.pi * (0.15 + waist * t)))
    outline = [(0.0, 0.0), *zip(radii, h * t, strict=True)]
    return Model("vase", (Part(lathe(outline, smooth=True), paint.printed(0.6)),))


def globe(rng: Rng, paint: Paint) -> Model:
    """A globe on a stand."""
    r = rng.uniform(0.09, 0.12)
    foot = lathe([(r * 0.75, 0.0), (r * 0.75, 0.012), (0.015, 0.03), (0.015, 0.12)])
    ring = tube(arc(r * 1.1, r * 1.1, -np.pi / 2, np.pi / 2, 20), 0.007)
    middle = 0.11 + r * 1.1
    return Model(
        "globe",
        (
            Part(foot, paint.wood()),
            Part(ring.moved((0, 0, middle)), paint.metal()),
            Part(sphere(r).moved((0, 0, middle - r)), paint.printed(0.35)),
        ),
    )


def toy_robot(rng: Rng, paint: Paint) -> Model:
    """A robot of painted blocks."""
    s = rng.uniform(0.9, 1.2)
    skin, trim = paint.bright(), paint.printed()
    blocks = [
        box(0.05, 0.07, 0.09).moved((-0.04, 0, 0)),
        box(0.05, 0.07, 0.09).moved((0.04, 0, 0)),
        box(0.035, 0.05, 0.11).moved((-0.105, 0, 0.10)),
        box(0.035, 0.05, 0.11).moved((0.105, 0, 0.10)),
    ]
    chest, head = box(0.17, 0.10, 0.13).moved((0, 0, 0.09)), box(0.11, 0.09, 0.085)
    eyes = [sphere(0.014, 16).moved((x, -0.045, 0.25)) for x in (-0.025, 0.025)]
    model = Model(
        "robot",
        (
            Part(join(blocks), skin),
            Part(chest, trim),
            Part(head.moved((0, 0, 0.225)), skin),
            Part(join(eyes), paint.plain((0.95, 0.95, 0.9))),
        ),
    )
    return model.scaled(s)


def toy_truck(rng: Rng, paint: Paint) -> Model:
    """A truck on four wheels."""
    length = rng.uniform(0.2, 0.28)
    wheel = disc(0.032, 0.014, 24)
    rim = join([cylinder(0.032, 0.014, 24), wheel]).moved((0, 0, 0), tilt=np.pi / 2)
    wheels = [
        rim.moved((x, y, 0.032)) for x in (-length * 0.33, length * 0.33) for y in (-0.052, 0.066)
    ]
    bed = box(length * 0.62, 0.11, 0.10).moved((-length * 0.17, 0, 0.045))
    cab = box(length * 0.3, 0.10, 0.08).moved((length * 0.34, 0, 0.045))
    return Model(
        "truck",
        (
            Part(join(wheels), paint.plain((0.13, 0.13, 0.14))),
            Part(bed, paint.printed()),
            Part(cab, paint.bright()),
        ),
    )


def picture_frame(rng: Rng, paint: Paint) -> Model:
    """A framed picture that leans back on its stand."""
    x, z = rng.uniform(0.18, 0.24), rng.uniform(0.22, 0.3)
    lean = -0.22
    frame = box(x, 0.016, z).moved(tilt=lean)
    face = box_front_back(x * 0.86, 0.019, z * 0.88).moved((0, 0, z * 0.06)).moved(tilt=lean)
    strut = box(0.03, 0.012, z * 0.74).moved((0, z * 0.38, 0), tilt=0.3)
    lift = 0.004
    return Model(
        "picture",
        (
            Part(frame.moved((0, 0, lift)), paint.wood()),
            Part(face.moved((0, 0, lift)), paint.cover()),
            Part(strut.moved((0, 0, lift)), paint.wood()),
        ),
    )


# --- on the floor -------------------------------------------------------------------------------


def chair(rng: Rng, paint: Paint) -> Model:
    """A plain chair: four legs, a seat, a back of three slats."""
    w, h, back = rng.uniform(0.34, 0.4), rng.uniform(0.42, 0.46), rng.uniform(0.36, 0.44)
    leg = 0.035
    posts = [box(leg, leg, h).moved((sx * (w - leg) / 2, -(w - leg) / 2, 0)) for sx in (-1, 1)]
    posts += [
        box(leg, leg, h + back).moved((sx * (w - leg) / 2, (w - leg) / 2, 0)) for sx in (-1, 1)
    ]
    slats = [
        box(w - 2 * leg, 0.02, 0.07).moved((0, (w - leg) / 2, h + back * t))
        for t in (0.25, 0.5, 0.78)
    ]
    seat = box(w, w, 0.04).moved((0, 0, h - 0.035))
    return Model("chair", (Part(join([*posts, *slats]), paint.wood()), Part(seat, paint.printed())))


def basket(rng: Rng, paint: Paint) -> Model:
    """A laundry basket with two handles."""
    r, h = rng.uniform(0.17, 0.21), rng.uniform(0.26, 0.34)
    wall = lathe([(0.0, 0.0), (r * 0.85, 0.0), (r, h * 0.5), (r * 0.95, h)])
    inner = lathe([(r * 0.95, h), (r * 0.9, h), (r * 0.8, 0.012), (0.0, 0.012)])
    loops = [
        tube(arc(0.05, 0.05, 0.0, np.pi), 0.01).moved((0, sy * r * 0.92, h * 0.98))
        for sy in (-1, 1)
    ]
    return Model(
        "basket",
        (
            Part(wall, paint.printed(0.0)),
            Part(inner, paint.wood()),
            Part(join(loops), paint.wood()),
        ),
    )


def crate(rng: Rng, paint: Paint) -> Model:
    """A slatted wooden crate."""
    x, y, z = rng.uniform(0.36, 0.46), rng.uniform(0.26, 0.32), rng.uniform(0.24, 0.3)
    slats = []
    for k in range(3):
        at, tall = z * (0.03 + 0.34 * k), z * 0.27
        slats += [box(x, 0.016, tall).moved((0, sy * y / 2, at)) for sy in (-1, 1)]
        slats += [box(0.016, y, tall).moved((sx * x / 2, 0, at)) for sx in (-1, 1)]
    floor = box(x, y, 0.015).moved((0, 0, 0.005))
    return Model("crate", (Part(join(slats), paint.printed(0.0)), Part(floor, paint.wood())))


def pouffe(rng: Rng, paint: Paint) -> Model:
    """A drum-shaped seat."""
    r, h = rng.uniform(0.18, 0.23), rng.uniform(0.3, 0.38)
    return Model(
        "pouffe",
        (
            Part(
                lathe([(r * 0.94, 0.0), (r, 0.03), (r, h - 0.03), (r * 0.94, h)]),
                paint.printed(0.0),
            ),
            Part(disc(r * 0.94, h), paint.printed(0.0)),
        ),
    )


TABLE: tuple[Builder, ...] = (
    tin,
    teapot,
    jar,
    vase,
    globe,
    toy_robot,
    toy_truck,
    picture_frame,
)
FLOOR: tuple[Builder, ...] = (chair, basket, crate, pouffe)
