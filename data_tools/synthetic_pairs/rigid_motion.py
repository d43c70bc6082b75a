"""Most of a room moves as one: the case that can turn scene and change round.

Sec. "Geometry Models Under Varying Change Conditions" of the paper's supplement moves more and more
of the movable things by similar motions. Here they share one exactly, so that a reconstruction may
as well take the moved things for the scene and the room for what moved.
"""

from dataclasses import replace

import numpy as np

from data_tools.synthetic_pairs.changes import Item, Place
from data_tools.synthetic_pairs.room import Room

GROUPS: tuple[tuple[str, ...], ...] = (
    ("table", "rug"),
    ("sideboard", "beside the sideboard"),
    ("shelf", "poster"),
)
"""What each step adds to what moves: furniture by label, things by what they stand on. The last
leaves little but the shell; its pictures then hang before their walls."""
TURN = np.radians(6.0)
SHIFT = (0.25, -0.15)
"""Metres along the back wall, towards the side of the table, and towards the cameras: nothing is
pushed through a wall or into what stays."""


def moved_together(
    room: Room, items: tuple[Item, ...], steps: int
) -> tuple[Room, tuple[Item, ...]]:
    """The first `steps` groups, moved by one rigid motion about the table; the rest stays.

    Furniture that moves becomes an item, so that the truth lists it among the changes.
    """
    chosen = {name for group in GROUPS[:steps] for name in group}
    staying = tuple(model for model in room.furniture if model.label not in chosen)
    going = [model for model in room.furniture if model.label in chosen]
    things: list[Item] = []
    for model in going:
        number = 1 + sum(item.model.label == model.label for item in things)
        here = Place("floor", 0.0, 0.0, 0.0, 0.0, 0.0)
        things.append(_moved(room, Item(0, f"{model.label}_{number}", model, None, here, here)))
    for item in items:
        goes = item.before is not None and item.before.support in chosen
        things.append(_moved(room, item) if goes else item)
    numbered = (replace(item, id=k) for k, item in enumerate(things, start=1 + len(staying)))
    return replace(room, furniture=staying), tuple(numbered)


def _moved(room: Room, item: Item) -> Item:
    assert item.before is not None
    return replace(item, kind="moved", after=_carried(room, item.before))


def _carried(room: Room, place: Place) -> Place:
    side = float(np.sign(room.table[0]))
    turn = side * TURN
    x, y = place.x - room.table[0], place.y - room.table[1]
    return replace(
        place,
        x=float(room.table[0] + np.cos(turn) * x - np.sin(turn) * y + side * SHIFT[0]),
        y=float(room.table[1] + np.sin(turn) * x + np.cos(turn) * y + SHIFT[1]),
        yaw=place.yaw + turn,
    )
