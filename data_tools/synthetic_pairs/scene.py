"""A whole pair before it is rendered: room, things, cameras, light and sensors."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from data_tools.synthetic_pairs import noise
from data_tools.synthetic_pairs.canvas import Rng
from data_tools.synthetic_pairs.changes import Item, Wish, arrange
from data_tools.synthetic_pairs.lighting import AreaLight, Lighting
from data_tools.synthetic_pairs.models import Model, Paint
from data_tools.synthetic_pairs.renderer import Renderer
from data_tools.synthetic_pairs.rigid_motion import moved_together
from data_tools.synthetic_pairs.room import CEILING, WINDOW_HEIGHT, Room, Support, build_room
from data_tools.synthetic_pairs.sensor import Sensor
from data_tools.synthetic_pairs.styles import TEST, VAL, Style
from data_tools.synthetic_pairs.tracer import Camera, Tracer
from data_tools.synthetic_pairs.trajectory import (
    Trajectories,
    cameras_along,
    cameras_between,
    plan_walks,
)
from scenediff_classic.types import VIDEOS, Kind, Video

HardCase = Literal[
    "low_texture", "repeated", "near_duplicate", "occlusion", "small", "no_change", "lighting"
]
ATTEMPTS = 120
PLACES = 12
"""Arrangements to try before other things are chosen."""
COLOURINGS = ((0, 1, 2), (2, 1, 0), (1, 0, 2))
"""Orders of the colour channels that tell near duplicates apart."""


@dataclass(frozen=True)
class PairSpec:
    """Everything that decides a pair: the same spec gives the same pair."""

    name: str
    seed: int
    frames: int = 10
    width: int = 640
    height: int = 480
    hard: tuple[HardCase, ...] = ()
    held_out: bool = False
    """Draw from the families of the `test` split."""
    close: bool = False
    """Walk near the table rather than through the room."""
    kinds: tuple[Kind, ...] | None = None
    """The changes; None = two to four at random."""
    texture_size: int = 2048
    """Side of the wall and floor textures in pixels; objects have an eighth of it."""
    rigid_motion: int = 0
    """Nothing changes but this: so many of `rigid_motion.GROUPS` move by one rigid motion."""
    trajectories: Trajectories = "diverging"
    """The same scene either way; only the after-cameras differ."""


@dataclass(frozen=True, eq=False)
class CapturePlan:
    """One walk with its light and its camera."""

    video: Video
    cameras: tuple[Camera, ...]
    lighting: Lighting
    sensor: Sensor


@dataclass(frozen=True, eq=False)
class Scene:
    """A pair, ready to be rendered."""

    spec: PairSpec
    room: Room
    items: tuple[Item, ...]
    before: CapturePlan
    after: CapturePlan

    def things(self, video: Video) -> list[tuple[int, Model]]:
        """(id, model in place) of all that stands in the room in one capture; 0 = walls."""
        fixed = [(0, self.room.shell), *enumerate(self.room.furniture, start=1)]
        places = [(item, item.before if video == "before" else item.after) for item in self.items]
        return fixed + [(item.id, item.standing(place)) for item, place in places if place]

    def plan(self, video: Video) -> CapturePlan:
        """The walk of one capture."""
        return self.before if video == "before" else self.after


def compose(spec: PairSpec) -> Scene:
    """The first arrangement in which every change can be seen well enough.

    Raises
    ------
    RuntimeError
        If no attempt succeeds; it means a spec that cannot be met, not bad luck.
    """
    style = TEST if spec.held_out else VAL
    if "low_texture" in spec.hard:
        style = style.without_texture()
    room = build_room(_rng(spec, "room"), style, spec.texture_size)
    plans = _captures(spec, room)
    wishes: list[Wish] = []
    for attempt in range(ATTEMPTS):
        if attempt % PLACES == 0:
            wishes = _wishes(_rng(spec, "things", attempt), spec, style, room)
        items = arrange(_rng(spec, "places", attempt), wishes, 1 + len(room.furniture))
        if items is None:
            continue
        if spec.rigid_motion:
            scene = Scene(spec, *moved_together(room, items, spec.rigid_motion), *plans)
            return _interpolating(scene) if spec.trajectories == "interpolating" else scene
        scene = Scene(spec, room, items, *plans)
        if _changes_show(scene):  # on diverging walks, whichever are asked for
            return _interpolating(scene) if spec.trajectories == "interpolating" else scene
    raise RuntimeError(f"no arrangement of pair {spec.name!r} shows all its changes")


def _rng(spec: PairSpec, *purpose: int | str) -> Rng:
    return np.random.default_rng(noise.seed_of(spec.seed, *purpose))


# --- things -------------------------------------------------------------------------------------


def _wishes(rng: Rng, spec: PairSpec, style: Style, room: Room) -> list[Wish]:
    kinds = _kinds(rng, spec)
    on_tops = 9 if "occlusion" in spec.hard else int(rng.integers(6, 9))
    on_floor = int(rng.integers(1, 3))
    low = 0 if spec.close else int(rng.integers(0, 2))  # how many changes are on the floor
    roles_low = [*kinds[:low], *[None] * on_floor][: max(on_floor, low)]
    roles_top = [*kinds[low:], *[None] * on_tops][:on_tops]
    families = _deal(rng, len(style.table_objects), on_tops)
    wishes: list[Wish] = []
    for role, family in zip(roles_top, families, strict=True):
        model = style.table_objects[family](rng, _paint(rng, style, spec))
        if "small" in spec.hard:
            model = model.scaled(0.6 if role else 0.75)
        supports = room.tops[:1] if spec.close and role else room.tops
        wishes.append(Wish(model, role, _halves(spec, supports, role)))
    for role, family in zip(
        roles_low, _deal(rng, len(style.floor_objects), len(roles_low)), strict=True
    ):
        model = style.floor_objects[family](rng, _paint(rng, style, spec))
        wishes.append(Wish(model, role, room.floors))
    return wishes + _lookalikes(rng, spec, style, room)


def _kinds(rng: Rng, spec: PairSpec) -> tuple[Kind, ...]:
    if "no_change" in spec.hard or spec.rigid_motion:
        return ()
    if spec.kinds is not None:
        return spec.kinds
    choices: tuple[Kind, ...] = ("added", "removed", "moved")
    return tuple(choices[k] for k in _deal(rng, len(choices), int(rng.integers(2, 5))))


def _lookalikes(rng: Rng, spec: PairSpec, style: Style, room: Room) -> list[Wish]:
    """Three copies of one thing, one of which goes; near duplicates differ in their colours."""
    if not {"repeated", "near_duplicate"} & set(spec.hard):
        return []
    family = style.table_objects[int(rng.integers(1, 3))]
    model = family(rng, _paint(rng, style, spec))
    change: Kind | None = None if "no_change" in spec.hard else "removed"
    wishes = []
    for role, channels in zip((change, None, None), COLOURINGS, strict=True):
        copy = model.recoloured(channels) if "near_duplicate" in spec.hard else model
        wishes.append(Wish(copy, role, room.tops[:1]))
    return wishes


def _halves(
    spec: PairSpec, supports: tuple[Support, ...], role: Kind | None
) -> tuple[Support, ...]:
    """In the occlusion case what changes stands at the back, and the rest before it."""
    if "occlusion" not in spec.hard:
        return supports
    table = supports[0]
    middle = (table.y[0] + table.y[1]) / 2
    y = (middle, table.y[1]) if role else (table.y[0], middle + 0.1)
    return (Support(table.name, table.x, y, table.z, table.headroom),)


def _deal(rng: Rng, families: int, count: int) -> list[int]:
    """Numbers below `families`, each once before any comes again."""
    dealt: list[int] = []
    while len(dealt) < count:
        dealt.extend(int(k) for k in rng.permutation(families))
    return dealt[:count]


def _paint(rng: Rng, style: Style, spec: PairSpec) -> Paint:
    return Paint(rng, style.prints, style.covers, style.woods, spec.texture_size // 8)


# --- light and cameras --------------------------------------------------------------------------


def _captures(spec: PairSpec, room: Room) -> tuple[CapturePlan, CapturePlan]:
    rng = _rng(spec, "captures")
    walks = plan_walks(rng, spec.frames, close=spec.close)
    strong = "lighting" in spec.hard
    plans = []
    for k, video in enumerate(VIDEOS):
        lamp, sun = rng.uniform(0.8, 1.1), rng.uniform(0.8, 1.2)
        if strong:  # by day from the window, by night from the lamp
            lamp, sun = (0.12, 1.6) if k == 0 else (1.2, 0.04)
        lighting = _lighting(rng, room, lamp, sun)
        cameras = cameras_along(walks[k], room, rng, spec.frames, spec.width, spec.height)
        tilt = 0.10 if strong else 0.04
        balance = (1 + rng.uniform(-tilt, tilt), 1.0, 1 + rng.uniform(-tilt, tilt))
        exposure = _metered(room, lighting, cameras) * rng.uniform(0.9, 1.12)
        sensor = Sensor(exposure, balance, rng.uniform(0.006, 0.012), rng.uniform(0.4, 0.6), 0.18)
        plans.append(CapturePlan(video, cameras, lighting, sensor))
    return plans[0], plans[1]


def _interpolating(scene: Scene) -> Scene:
    rng = _rng(scene.spec, "between")
    cameras = cameras_between(scene.before.cameras, scene.after.cameras, rng)
    return replace(scene, after=replace(scene.after, cameras=cameras))


def _lighting(rng: Rng, room: Room, lamp: float, sun: float) -> Lighting:
    """A warm lamp under the ceiling and daylight from the window."""
    x, y = rng.uniform(-0.5, 0.5), room.depth - rng.uniform(1.5, 2.2)
    warm = (4.6 * lamp, 4.0 * lamp, 3.2 * lamp)
    ceiling = AreaLight((x - 0.25, y - 0.25, CEILING - 0.15), (0, 0.5, 0), (0.5, 0, 0), warm)
    wall, y0, y1, z0 = room.window
    inward = -np.sign(wall)
    near = wall + inward * 0.08
    edges = ((0.0, y1 - y0, 0.0), (0.0, 0.0, WINDOW_HEIGHT))
    edge_u, edge_v = edges if inward > 0 else edges[::-1]
    cool = (3.0 * sun, 3.4 * sun, 4.0 * sun)
    window = AreaLight((near, y0, z0), edge_u, edge_v, cool)
    fill = 0.25 * lamp + 0.2 * sun
    return Lighting(
        (ceiling, window),
        sky=(fill, fill, fill),
        ground=(0.62 * fill, 0.54 * fill, 0.46 * fill),
        outdoors=0.1 + 2.6 * sun,
    )


def _metered(room: Room, lighting: Lighting, cameras: tuple[Camera, ...]) -> float:
    """Exposure that brings the middle frame's mean to mid-grey, as a camera would."""
    fixed = [(0, room.shell), *((0, model) for model in room.furniture)]
    camera = _shrunk(cameras[len(cameras) // 2], 8)
    radiance = Renderer(fixed, lighting).render(camera, seed=1, samples=1).radiance
    return 0.33 / float(np.minimum(radiance, 1.5).mean(dtype=np.float64))


def _shrunk(camera: Camera, factor: int) -> Camera:
    width, height = camera.width // factor, camera.height // factor
    scale = np.diag([width / camera.width, height / camera.height, 1.0])
    return Camera(width, height, scale @ camera.intrinsics, camera.cam_from_world)


def _changes_show(scene: Scene) -> bool:
    """Whether each change has pixels enough in enough frames of its capture."""
    hidden = {"occlusion", "small"} & set(scene.spec.hard)
    share, frames = (0.0005, 0.34) if hidden else (0.0012, 0.6)
    for video in VIDEOS:
        ids = [
            item.id
            for item in scene.items
            if item.kind and (item.before if video == "before" else item.after)
        ]
        if not ids:
            continue
        plan = scene.plan(video)
        tracer = Tracer(scene.things(video))
        maps = [tracer.identify(_shrunk(camera, 4)) for camera in plan.cameras]
        for identity in ids:
            seen = [np.count_nonzero(m == identity) > share * m.size for m in maps]
            if np.mean(seen) < frames:
                return False
    return True
