"""A rendered pair on disk: the SceneDiff Benchmark's layout, and the truth that it lacks."""

import json
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from fractions import Fraction
from multiprocessing.pool import ThreadPool
from pathlib import Path

import av
import numpy as np
from jaxtyping import UInt8
from PIL import Image

from data_tools.synthetic_pairs import noise
from data_tools.synthetic_pairs.renderer import Renderer, Rendering
from data_tools.synthetic_pairs.scene import PairSpec, Scene, compose
from scenediff_classic import masks
from scenediff_classic.dataset import (
    SAMPLE_STEP,
    AnnotatedMask,
    AnnotatedObject,
    AnnotatedPair,
    Track,
    write_annotations,
)
from scenediff_classic.errors import OutputError
from scenediff_classic.types import VIDEOS, Video

Report = Callable[[int, int], None]
"""Called with (frames done, frames in all)."""
WORKERS = 2
"""Frames in work at once; the result does not depend on it."""


@dataclass(frozen=True)
class Shot:
    """One frame of a capture: the picture and its truth."""

    video: Video
    index: int
    image: UInt8[np.ndarray, "h w 3"]
    truth: Rendering


def write_pair(spec: PairSpec, root: Path, report: Report = lambda done, total: None) -> bool:
    """Render a pair into ``root/<name>``; a pair that is there already is left as it is.

    Returns
    -------
    bool
        False if the pair was there.

    Raises
    ------
    OutputError
        The folder cannot be written.
    """
    folder, unfinished = root / spec.name, root / f".{spec.name}.part"
    if (folder / "metadata.json").is_file():
        return False
    try:
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        scene = compose(spec)
        shots = shoot(scene, report)
        _write_pictures(shots, unfinished)
        _write_truth(scene, shots, unfinished)
        shutil.rmtree(folder, ignore_errors=True)
        unfinished.rename(folder)
    except OSError as error:
        raise OutputError(f"Cannot write {folder}: {error.strerror or error}.") from error
    return True


def shoot(scene: Scene, report: Report = lambda done, total: None) -> list[Shot]:
    """Render all frames of both captures."""
    total = sum(len(scene.plan(video).cameras) for video in VIDEOS)
    shots: list[Shot] = []
    for video in VIDEOS:
        plan = scene.plan(video)
        renderer = Renderer(scene.things(video), plan.lighting)

        def take(index: int, video: Video = video, renderer: Renderer = renderer) -> Shot:
            plan = scene.plan(video)
            seed = noise.seed_of(scene.spec.seed, video, index)
            truth = renderer.render(plan.cameras[index], seed)
            return Shot(video, index, plan.sensor.expose(truth.radiance, seed), truth)

        with ThreadPool(WORKERS) as pool:
            for shot in pool.imap(take, range(len(plan.cameras))):
                shots.append(shot)
                report(len(shots), total)
    return shots


def annotate(scene: Scene, shots: list[Shot]) -> AnnotatedPair:
    """The truth as an annotator would give it: visible pixels of what changed.

    A frame in which an object has no pixel is left out.
    """
    tracks, objects = [], []
    for item in (item for item in scene.items if item.kind):
        seen: dict[Video, tuple[AnnotatedMask, ...]] = {}
        for video in VIDEOS:
            here = (s for s in shots if s.video == video)
            visible = ((s.index, s.truth.instances == item.id) for s in here)
            seen[video] = tuple(
                AnnotatedMask(SAMPLE_STEP * index, masks.encode(mask))
                for index, mask in visible
                if mask.any()
            )
            if seen[video]:
                tracks.append(Track(video, item.id, seen[video]))
        objects.append(
            AnnotatedObject(
                item.id,
                item.name,
                item.before is not None,
                item.after is not None,
                deformability="rigid",
                frame_before=seen["before"][0].frame if seen["before"] else None,
                frame_after=seen["after"][0].frame if seen["after"] else None,
            )
        )
    tracks.sort(key=lambda track: VIDEOS.index(track.video))
    return AnnotatedPair("synthetic", tuple(tracks), tuple(objects))


def _write_pictures(shots: list[Shot], folder: Path) -> None:
    for number, video in enumerate(VIDEOS, start=1):
        images = [shot.image for shot in shots if shot.video == video]
        (folder / video).mkdir()
        for index, image in enumerate(images):
            Image.fromarray(image).save(folder / video / f"{index:04d}.png")
        write_video(images, folder / f"original_video{number}.mp4")


def write_video(images: list[UInt8[np.ndarray, "h w 3"]], path: Path) -> None:
    """One frame a second: frame k is shown at second k."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=1, options={"crf": "12", "threads": "1"})
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, 1)
        for index, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = index, Fraction(1, 1)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def _write_truth(scene: Scene, shots: list[Shot], folder: Path) -> None:
    write_annotations(annotate(scene, shots), folder)
    cameras = [scene.plan(s.video).cameras[s.index] for s in shots]
    depth = np.stack([s.truth.depth for s in shots])
    video = np.array([VIDEOS.index(s.video) for s in shots], np.uint8)
    index = np.array([s.index for s in shots], np.int32)
    np.savez_compressed(
        folder / "truth_geometry.npz",
        intrinsics=np.stack([c.intrinsics for c in cameras]),
        cam_from_world=np.stack([c.cam_from_world for c in cameras]),
        depth=depth,
        confidence=np.isfinite(depth).astype(np.float16),
        video=video,
        index=index,
    )
    fixed = [
        (k, f"{model.label}_{k}", model.label, "fixed")
        for k, model in enumerate(scene.room.furniture, start=1)
    ]
    movable = [(i.id, i.name, i.model.label, i.kind or "unchanged") for i in scene.items]
    ids, names, labels, kinds = zip(*fixed, *movable, strict=True)
    np.savez_compressed(
        folder / "truth_instances.npz",
        instances=np.stack([s.truth.instances for s in shots]),
        video=video,
        index=index,
        id=np.array(ids),
        name=np.array(names),
        label=np.array(labels),
        kind=np.array(kinds),
    )
    about = {"scene_type": "synthetic", "fps": 1, **asdict(scene.spec)}
    # other pairs keep their files bit for bit
    if not scene.spec.rigid_motion:
        del about["rigid_motion"]
    if scene.spec.trajectories == "diverging":
        del about["trajectories"]
    (folder / "metadata.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
