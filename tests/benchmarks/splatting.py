"""How good and how fast Gaussian splatting is on a rendered capture with true cameras.

``python -m tests.benchmarks.splatting`` renders a room (24 frames of 320x240), holds out every
eighth frame, trains on the others from the depth that stereo finds in them, and prints the PSNR of
the held-out frames, the error of the rendered depth, and what an iteration costs;
``--speed`` prints how the cost grows with Gaussians and pixels, and the share of each step.
"""

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro
from jaxtyping import Float, Float32

from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import Gaussians, Points
from baselines.gaussian_splatting.losses import psnr
from baselines.gaussian_splatting.rasterizer import render
from baselines.gaussian_splatting.train import Trained, TrainConfig, TrainProgress, train
from data_tools.synthetic_pairs.export import write_pair
from data_tools.synthetic_pairs.scene import PairSpec
from scenediff_classic.geometry.stereo.multi_view import MultiViewStereo
from scenediff_classic.protocols import silent
from scenediff_classic.types import Geometry, SparsePoints, View
from tests.benchmarks.stereo import Truth, rendered_capture
from tests.geometry.textured_room import room

Start = Literal["stereo", "sparse"]
HOLD_OUT = 8
"""Every so many frames, one is held out."""


@dataclass(frozen=True)
class Quality:
    """What is measured on the frames that were held out."""

    psnr: float
    """Mean over the frames, in dB."""
    depth_error: float
    """Median relative error of the rendered depth, in percent of the true one."""
    depth_known: float
    """Share of the pixels with rendered depth, in percent."""


def quality(gaussians: Gaussians, views: Sequence[View], truth: Truth) -> Quality:
    """Rendered against true pictures and depth."""
    ratios, errors, known = [], [], []
    for view, depth in zip(views, truth, strict=True):
        with torch.no_grad():
            drawn = render(gaussians, PinholeCamera.of(view))
        shown = drawn.rgb.clamp(0, 1).numpy()
        ratios.append(psnr(float(np.mean((shown - view.image / 255.0) ** 2))))
        error = np.abs(drawn.depth.numpy() / depth - 1)[np.isfinite(depth)]
        errors.append(error[np.isfinite(error)])
        known.append(float(np.mean(np.isfinite(error))))
    median = float(np.median(np.concatenate(errors)))
    return Quality(float(np.mean(ratios)), 100 * median, 100 * float(np.mean(known)))


def held_out(count: int) -> list[int]:
    """Positions of the frames that are not trained on."""
    return list(range(0, count, HOLD_OUT))


def part_of(geometry: Geometry, chosen: Sequence[int]) -> Geometry:
    """Some of the views, and what they observe."""
    place = np.full(len(geometry.views), -1)
    place[list(chosen)] = np.arange(len(chosen))
    seen = geometry.points.observations
    seen = np.c_[seen[:, 0], place[seen[:, 1]]][place[seen[:, 1]] >= 0]
    points = SparsePoints(geometry.points.xyz, geometry.points.rgb, seen)
    return Geometry(tuple(geometry.views[i] for i in chosen), points)


def starting_points(geometry: Geometry, start: Start, most: int) -> Points:
    """Where Gaussians start: the depth that stereo finds, or the sparse points."""
    if start == "sparse":
        return Points.of(geometry)
    with tempfile.TemporaryDirectory() as folder:
        return Points.of(MultiViewStereo()(geometry, Path(folder), silent), most=most)


@dataclass(frozen=True)
class Cost:
    """What a training took."""

    cpu_s: float
    """CPU seconds an iteration."""
    wall_s: float
    """Seconds in all."""


def trained(
    geometry: Geometry,
    points: Points,
    config: TrainConfig,
    report: Callable[[TrainProgress], None] | None = None,
) -> tuple[Trained, Cost]:
    """Train, and measure the time."""
    cpu, wall = time.process_time(), time.monotonic()
    result = train(geometry.views, points, config, progress=report)
    cpu_s = (time.process_time() - cpu) / config.iterations
    return result, Cost(cpu_s, time.monotonic() - wall)


# --- speed --------------------------------------------------------------------------------------


def wall_of_gaussians(count: int, seed: int = 0) -> tuple[Gaussians, PinholeCamera]:
    """Gaussians on wavy walls before a camera of 320x240, sized so that they cover it."""
    rng = np.random.default_rng(seed)
    camera = PinholeCamera(
        np.array([[280.0, 0, 160], [0, 280, 120], [0, 0, 1]]), np.eye(4), 240, 320
    )
    depth = 3 + 0.5 * np.sin(np.arange(count)) + (rng.random(count) < 0.3)
    xyz = np.c_[rng.uniform(-1, 1, (count, 2)) * [0.6, 0.45] * depth[:, None], depth]
    scales = np.log(2.4 / np.sqrt(count)) + rng.normal(0, 0.4, (count, 3))
    sh = rng.normal(0, 0.2, (count, 9, 3))
    arrays = (xyz, scales, rng.normal(size=(count, 4)), rng.normal(0, 1.5, count), sh)
    return Gaussians(*(torch.tensor(a, dtype=torch.float32) for a in arrays)), camera


def iteration_cost(
    gaussians: Gaussians, camera: PinholeCamera, rounds: int = 5
) -> tuple[float, float]:
    """CPU seconds of a rendering, and of a rendering with its gradients."""
    leaves = gaussians.map(lambda t: t.requires_grad_())

    def both() -> None:
        render(leaves, camera).rgb.sum().backward()

    return _cpu(lambda: render(gaussians.detached(), camera), rounds), _cpu(both, rounds)


def _cpu(action: Callable[[], object], rounds: int) -> float:
    action()  # compiles
    started = time.process_time()
    for _ in range(rounds):
        action()
    return (time.process_time() - started) / rounds
