"""Rendered scenes for training and judging the networks, kept on disk as compressed shards.

A scene has a few frames of either capture with exact depth and cameras, and *sites*: places where
a changed object stands in one capture alone. A moved object has two. In the capture without the
object, a site's box is that of the object rendered as if it were there, with occlusion.

``python -m baselines.cyws.scenes --split train --scenes 1000 -o SHARDS`` renders them; shards
that are there already are kept.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from jaxtyping import Float32, Float64, Int8, Int32, UInt8

from data_tools.synthetic_pairs import noise
from data_tools.synthetic_pairs.renderer import Renderer
from data_tools.synthetic_pairs.scene import HardCase, PairSpec, Scene, compose
from data_tools.synthetic_pairs.tracer import Camera, Tracer
from scenediff_classic.errors import InputError, SceneDiffError
from scenediff_classic.types import VIDEOS, Video
from scenediff_classic.workspace import load_npz, save_npz

ScenesOf = Literal["train", "val", "test"]
"""``train`` and ``val`` share families of objects and textures; ``test`` has its own."""

FIRST_SEED: dict[ScenesOf, int] = {"train": 2_000_000, "val": 3_000_000, "test": 4_000_000}
SHARD = 16
"""Scenes in a file."""
ABSENT = 1000
"""Id of the first object rendered as if it were there; instances have lower ones."""
CASES: tuple[tuple[HardCase, ...], ...] = (
    (), (), (), (), (), (),
    ("lighting",), ("lighting",), ("occlusion",), ("repeated",), ("near_duplicate",),
    ("low_texture",), ("small",), ("no_change",), ("no_change",), ("no_change", "lighting"),
)  # fmt: skip
"""What makes the scenes of a shard hard, in turn."""


@dataclass(frozen=True)
class SceneFrames:
    """Some frames of both captures of one scene, and the sites of its changes.

    The cameras are pinhole; depth is z-depth in metres, NaN where nothing is.
    """

    images: UInt8[np.ndarray, "n h w 3"]
    depth: Float32[np.ndarray, "n h w"]
    intrinsics: Float64[np.ndarray, "n 3 3"]
    cam_from_world: Float64[np.ndarray, "n 4 4"]
    video: Int8[np.ndarray, "n"]
    """0 = before, 1 = after."""
    present: Int8[np.ndarray, "k"]
    """The capture in which a site's object stands."""
    boxes: Float32[np.ndarray, "k n 4"]
    """Visible part of a site's object, or what would be visible of it: x0, y0, x1, y1 in pixels;
    zeros if nothing."""
    pixels: Int32[np.ndarray, "k n"]
    """Pixels in that part."""


@dataclass(frozen=True)
class RenderScenes:
    """Render scenes into shards."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the shards, one below it for each split."""
    split: ScenesOf = "train"
    scenes: int = 1000
    """Rounded up to whole shards."""
    frames: int = 4
    """Frames of each capture."""
    width: int = 160
    height: int = 128

    def __call__(self) -> list[Path]:
        """Render what is missing; returns all shards."""
        if self.scenes < 1 or self.frames < 2:
            raise InputError("--scenes must be at least 1 and --frames at least 2.")
        shards = []
        for number in range(-(-self.scenes // SHARD)):
            path = self.out / self.split / f"{number:05d}.npz"
            if not path.is_file():
                found = [render_scene(self.spec(number * SHARD + k)) for k in range(SHARD)]
                write_shard(path, found)
                print(f"{path} written", file=sys.stderr, flush=True)
            shards.append(path)
        return shards

    def spec(self, number: int) -> PairSpec:
        """What decides one of the scenes."""
        return PairSpec(
            f"{self.split}_{number:05d}",
            FIRST_SEED[self.split] + number,
            self.frames,
            self.width,
            self.height,
            CASES[number % len(CASES)],
            held_out=self.split == "test",
            close=number // len(CASES) % 2 == 0,
            texture_size=512,
        )


def render_scene(spec: PairSpec) -> SceneFrames:
    """Frames and sites of a scene; lenses are up to half as long again as those of the named sets.

    The same spec gives the same scene. Where no arrangement shows all changes, the next seed's is
    taken.
    """
    scene, seed = None, spec.seed
    while scene is None:
        try:
            scene = compose(replace(spec, seed=seed))
        except RuntimeError:
            seed += 500_000
    zoom = 1 + 0.5 * np.random.default_rng(noise.seed_of(seed, "zoom")).uniform()
    sites = Sites(scene)
    images, depth, cameras, found = [], [], [], []
    for video in VIDEOS:
        plan = scene.plan(video)
        renderer = Renderer(scene.things(video), plan.lighting)
        for index, camera in enumerate(plan.cameras):
            zoomed = _zoomed(camera, zoom)
            at = noise.seed_of(seed, video, index)
            truth = renderer.render(zoomed, at)
            images.append(plan.sensor.expose(truth.radiance, at))
            depth.append(truth.depth)
            cameras.append(zoomed)
            found.append(sites.boxes(video, zoomed))
    return SceneFrames(
        images=np.stack(images),
        depth=np.stack(depth),
        intrinsics=np.stack([c.intrinsics for c in cameras]),
        cam_from_world=np.stack([c.cam_from_world for c in cameras]),
        video=np.repeat(np.arange(2, dtype=np.int8), spec.frames),
        present=sites.present,
        boxes=np.stack([boxes for boxes, _ in found], 1),
        pixels=np.stack([pixels for _, pixels in found], 1),
    )


class Sites:
    """Where the changed objects of a scene stand, and what a camera sees or would see of them."""

    def __init__(self, scene: Scene) -> None:
        self._sites = [
            (item.id, item.standing(place), video)
            for item in scene.items
            if item.kind
            for video, place in zip(VIDEOS, (item.before, item.after), strict=True)
            if place
        ]
        self.present = np.array([VIDEOS.index(video) for _, _, video in self._sites], np.int8)
        """The capture in which each object stands there."""
        self._real, self._as_if = {}, {}
        for video in VIDEOS:
            things = scene.things(video)
            absent = [(ABSENT + k, m) for k, (_, m, at) in enumerate(self._sites) if at != video]
            self._real[video], self._as_if[video] = Tracer(things), Tracer([*things, *absent])

    def boxes(
        self, video: Video, camera: Camera
    ) -> tuple[Float32[np.ndarray, "k 4"], Int32[np.ndarray, "k"]]:
        """Boxes and counts of the visible pixels of all sites."""
        real = self._real[video].identify(camera)
        as_if = self._as_if[video].identify(camera)
        found = [
            _box(real == item if at == video else as_if == ABSENT + k)
            for k, (item, _, at) in enumerate(self._sites)
        ]
        boxes = np.array([box for box, _ in found], np.float32).reshape(-1, 4)
        return boxes, np.array([count for _, count in found], np.int32)


def _zoomed(camera: Camera, zoom: float) -> Camera:
    longer = np.array([[zoom, 1, 1], [1, zoom, 1], [1, 1, 1]])
    return replace(camera, intrinsics=camera.intrinsics * longer)


def _box(mask: np.ndarray) -> tuple[tuple[float, float, float, float], int]:
    if not mask.any():
        return (0.0, 0.0, 0.0, 0.0), 0
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    box = float(columns[0]), float(rows[0]), float(columns[-1] + 1), float(rows[-1] + 1)
    return box, int(mask.sum())


# --- shards -------------------------------------------------------------------------------------


def write_shard(path: Path, scenes: list[SceneFrames]) -> None:
    """Keep scenes in one file; depth is rounded to half precision (1 mm at 2 m)."""
    counts = np.array([len(s.present) for s in scenes])
    save_npz(
        path,
        images=np.stack([s.images for s in scenes]),
        depth=np.stack([s.depth for s in scenes]).astype(np.float16),
        intrinsics=np.stack([s.intrinsics for s in scenes]),
        cam_from_world=np.stack([s.cam_from_world for s in scenes]),
        video=np.stack([s.video for s in scenes]),
        sites=counts,
        present=np.concatenate([s.present for s in scenes]),
        boxes=np.concatenate([s.boxes for s in scenes]),
        pixels=np.concatenate([s.pixels for s in scenes]),
    )


def read_shards(folder: Path, limit: int | None = None) -> list[SceneFrames]:
    """The scenes of all shards in a folder, in the order of their names.

    Raises
    ------
    InputError
        If there is none, or one is damaged.
    """
    paths = sorted(folder.glob("[0-9]*.npz"))
    if not paths:
        raise InputError(
            f"{folder} holds no rendered scenes: make some with baselines.cyws.scenes."
        )
    scenes: list[SceneFrames] = []
    for path in paths:
        if limit is not None and len(scenes) >= limit:
            break
        scenes.extend(_read_shard(path))
    return scenes[:limit]


def _read_shard(path: Path) -> Iterator[SceneFrames]:
    stored = load_npz(path)
    if stored is None:
        raise InputError(f"{path} is damaged: remove it and render it again.")
    ends = np.cumsum(stored["sites"])
    for k, end in enumerate(ends):
        at = slice(end - stored["sites"][k], end)
        yield SceneFrames(
            images=stored["images"][k],
            depth=stored["depth"][k].astype(np.float32),
            intrinsics=stored["intrinsics"][k],
            cam_from_world=stored["cam_from_world"][k],
            video=stored["video"][k],
            present=stored["present"][at],
            boxes=stored["boxes"][at],
            pixels=stored["pixels"][at],
        )


if __name__ == "__main__":
    try:
        tyro.cli(RenderScenes)()
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
