"""Pairs of `data_tools.synthetic_pairs` as scenes to judge the networks on, with true geometry or
with that of a finished run of the method."""

import json
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from baselines.cyws.scenes import SceneFrames, Sites
from data_tools.synthetic_pairs.scene import PairSpec, compose
from data_tools.synthetic_pairs.tracer import Camera
from scenediff_classic.cameras import scale_intrinsics
from scenediff_classic.errors import InputError
from scenediff_classic.geometry.store import SavedGeometry
from scenediff_classic.protocols import silent
from scenediff_classic.types import VIDEOS, Geometry
from scenediff_classic.video import read_capture
from scenediff_classic.workspace import load_npz


def read_rendered(folder: Path, size: tuple[int, int] | None = None) -> SceneFrames:
    """All frames of a rendered pair; its scene is composed anew to box what is not there.

    Parameters
    ----------
    size : (height, width), optional
        Of the frames instead of their own, whatever the aspect. Boxes are then traced at that
        size, in a fraction of the time.

    Raises
    ------
    InputError
        If the folder holds no rendered pair.
    """
    truth = load_npz(folder / "truth_geometry.npz")
    try:
        about = json.loads((folder / "metadata.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{folder} holds no rendered pair.") from error
    if truth is None:
        raise InputError(f"{folder} holds no true geometry.")
    known = {field.name for field in fields(PairSpec)}
    options = {k: tuple(v) if isinstance(v, list) else v for k, v in about.items() if k in known}
    # where things stand does not depend on their textures, and small ones are made in no time
    scene = compose(PairSpec(**{**options, "texture_size": 64}))
    height, width = truth["depth"].shape[1:] if size is None else size
    sites, images, found = Sites(scene), [], []
    for video, index in zip(truth["video"], truth["index"], strict=True):
        name = VIDEOS[int(video)]
        images.append(np.asarray(Image.open(folder / name / f"{int(index):04d}.png")))
        camera = _at_size(scene.plan(name).cameras[int(index)], height, width)
        found.append(sites.boxes(name, camera))
    frames = SceneFrames(
        images=np.stack(images),
        depth=truth["depth"].astype(np.float32),
        intrinsics=truth["intrinsics"],
        cam_from_world=truth["cam_from_world"],
        video=truth["video"].astype(np.int8),
        present=sites.present,
        boxes=np.stack([boxes for boxes, _ in found], 1),
        pixels=np.stack([pixels for _, pixels in found], 1),
    )
    if size is None:
        return frames
    # boxes and their pixels were traced at that size
    return replace(resized(frames, *size), boxes=frames.boxes, pixels=frames.pixels)


def _at_size(camera: Camera, height: int, width: int) -> Camera:
    x, y = width / camera.width, height / camera.height
    lens = scale_intrinsics(camera.intrinsics, x, y)
    return Camera(width, height, lens, camera.cam_from_world)


def finished_geometry(pair: Path, run: Path) -> Geometry:
    """What a run of the method found out of the pair's pictures."""
    captures = [read_capture(pair / video, video) for video in VIDEOS]
    return SavedGeometry(run)(captures[0], captures[1], run, silent)


def with_geometry(scene: SceneFrames, geometry: Geometry) -> SceneFrames:
    """The same frames with found cameras and depth; those without a camera have no depth.

    Pictures stay as they are: the lens distortion that was found is taken as none.
    """
    height, width = scene.depth.shape[1:]
    depth = np.full_like(scene.depth, np.nan)
    intrinsics, poses = scene.intrinsics.copy(), scene.cam_from_world.copy()
    index = np.concatenate([np.arange((scene.video == v).sum()) for v in (0, 1)])
    place = {
        (VIDEOS[v], int(i)): k for k, (v, i) in enumerate(zip(scene.video, index, strict=True))
    }
    for view in geometry.views:
        k = place[view.key]
        rows, columns = view.shape
        depth[k] = cv2.resize(view.depth, (width, height), interpolation=cv2.INTER_NEAREST)
        intrinsics[k] = scale_intrinsics(view.intrinsics, width / columns, height / rows)
        poses[k] = view.cam_from_world
    return replace(scene, depth=depth, intrinsics=intrinsics, cam_from_world=poses)


def resized(scene: SceneFrames, height: int, width: int) -> SceneFrames:
    """At another size, whatever the aspect; counts of pixels are those of the new size."""
    x, y = width / scene.images.shape[2], height / scene.images.shape[1]
    size = (width, height)
    return replace(
        scene,
        images=np.stack([cv2.resize(i, size, interpolation=cv2.INTER_AREA) for i in scene.images]),
        depth=np.stack([cv2.resize(d, size, interpolation=cv2.INTER_NEAREST) for d in scene.depth]),
        intrinsics=np.stack([scale_intrinsics(k, x, y) for k in scene.intrinsics]),
        boxes=scene.boxes * np.array([x, y, x, y], np.float32),
        pixels=np.round(scene.pixels * x * y).astype(np.int32),
    )
