"""What stands where before and after: placement with physical support, and the changes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from data_tools.synthetic_pairs.canvas import Rng
from data_tools.synthetic_pairs.models import Model
from data_tools.synthetic_pairs.room import Support
from scenediff_classic.types import Kind

GAP = 0.025
"""Metres between the bounding cylinders of neighbours: nothing touches."""
MOVE_AT_LEAST = 0.30
"""Metres between the old and the new place of a moved object."""


@dataclass(frozen=True)
class Place:
    """Where a thing stands: on a support, inside an upright cylinder of its own."""

    support: str
    x: float
    y: float
    z: float
    yaw: float
    radius: float


@dataclass(frozen=True, eq=False)
class Item:
    """A movable thing and what becomes of it."""

    id: int
    name: str
    """Label and number, as in the benchmark: ``mug_1``."""
    model: Model
    kind: Kind | None
    """None = unchanged."""
    before: Place | None
    after: Place | None

    def standing(self, place: Place) -> Model:
        """The model put down there."""
        return self.model.moved(place.x, place.y, place.z, place.yaw)


@dataclass(frozen=True, eq=False)
class Wish:
    """A thing that wants a place on one of some supports."""

    model: Model
    kind: Kind | None
    supports: tuple[Support, ...]


def arrange(rng: Rng, wishes: Sequence[Wish], first_id: int) -> tuple[Item, ...] | None:
    """Places for all, or None if the generator found no room for a thing.

    All places are apart from each other, the old and the new ones alike: so neither arrangement
    has two things in one spot, and nothing is put where something else was taken away.
    """
    taken: list[Place] = []
    items: list[Item] = []
    numbers: dict[str, int] = {}
    # The widest first: it is the hardest to place.
    for wish in sorted(wishes, key=lambda w: -w.model.radius):
        first = _find(rng, wish, taken, away_from=None)
        if first is None:
            return None
        taken.append(first)
        second = first
        if wish.kind == "moved":
            second = _find(rng, wish, taken, away_from=first)
            if second is None:
                return None
            taken.append(second)
        label = wish.model.label
        numbers[label] = numbers.get(label, 0) + 1
        items.append(
            Item(
                first_id + len(items),
                f"{label}_{numbers[label]}",
                wish.model,
                wish.kind,
                None if wish.kind == "added" else first,
                None if wish.kind == "removed" else second,
            )
        )
    return tuple(items)


def _find(
    rng: Rng, wish: Wish, taken: Sequence[Place], away_from: Place | None, tries: int = 80
) -> Place | None:
    radius, height = wish.model.radius, wish.model.height
    areas = np.array([(s.x[1] - s.x[0]) * (s.y[1] - s.y[0]) for s in wish.supports])
    for _ in range(tries):
        support = wish.supports[int(rng.choice(len(areas), p=areas / areas.sum()))]
        x0, x1 = support.x[0] + radius, support.x[1] - radius
        y0, y1 = support.y[0] + radius, support.y[1] - radius
        x, y, yaw = rng.uniform(0, 1), rng.uniform(0, 1), rng.uniform(0, 2 * np.pi)
        if x0 > x1 or y0 > y1 or height > support.headroom:
            continue
        place = Place(support.name, x0 + x * (x1 - x0), y0 + y * (y1 - y0), support.z, yaw, radius)
        if away_from is not None and _distance(place, away_from) < MOVE_AT_LEAST:
            continue
        if all(_apart(place, other) for other in taken):
            return place
    return None


def _distance(a: Place, b: Place) -> float:
    return float(np.sqrt((a.x - b.x) ** 2 + (a.y - b.y) ** 2 + (a.z - b.z) ** 2))


def _apart(a: Place, b: Place) -> bool:
    if a.support != b.support:
        return True  # supports lie beside or above each other, with headroom
    return bool(np.sqrt((a.x - b.x) ** 2 + (a.y - b.y) ** 2) >= a.radius + b.radius + GAP)
