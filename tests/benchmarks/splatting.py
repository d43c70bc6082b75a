"""How good and how fast Gaussian splatting is on a rendered capture with true cameras.

``python -m tests.benchmarks.splatting`` renders a room (24 frames of 320x240), holds out every
eighth frame, trains on the others from the depth that stereo finds in them, and prints the PSNR of
the held-out frames, the error of the rendered depth, and what an iteration costs;
``--photos FOLDER`` does the same with real pictures, whose cameras are found first, all in one;
``--plain`` also trains without what makes an iteration cheap, to see what that costs in quality;
``--speed`` prints how the cost grows with Gaussians and pixels, and the share of each step.
"""

import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
import tyro

from baselines.gaussian_splatting.adam import NAMES, Adam
from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import Gaussians, Points
from baselines.gaussian_splatting.losses import Target, photometric_loss, psnr
from baselines.gaussian_splatting.rasterizer import _project, render
from baselines.gaussian_splatting.train import TrainConfig, Trained, TrainProgress, train
from data_tools.synthetic_pairs.export import write_pair
from data_tools.synthetic_pairs.scene import PairSpec
from scenediff_classic.errors import SceneDiffError
from scenediff_classic.geometry.registration.structure_from_motion import StructureFromMotion
from scenediff_classic.geometry.stereo.multi_view import MultiViewStereo
from scenediff_classic.protocols import silent
from scenediff_classic.types import Capture, Frame, Geometry, SparsePoints, Video, View
from scenediff_classic.video import read_capture
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
    """Median relative error of the rendered depth, in percent of the true one; NaN if unknown."""
    depth_known: float
    """Share of the pixels with rendered depth, in percent; NaN if no true one is known."""

    def __str__(self) -> str:
        """One row of the table."""
        if np.isnan(self.depth_known):
            return f"{self.psnr:.1f} dB"
        return (
            f"{self.psnr:.1f} dB, depth off by {self.depth_error:.2f} % (median), "
            f"rendered for {self.depth_known:.1f} % of the pixels"
        )


def quality(gaussians: Gaussians, views: Sequence[View], truth: Truth) -> Quality:
    """Rendered against true pictures and depth."""
    ratios, errors = [], []
    for view, depth in zip(views, truth, strict=True):
        with torch.no_grad():
            drawn = render(gaussians, PinholeCamera.of(view))
        shown = drawn.rgb.clamp(0, 1).numpy()
        ratios.append(psnr(float(np.mean((shown - view.image / 255.0) ** 2))))
        errors.append(np.abs(drawn.depth.numpy() / depth - 1)[np.isfinite(depth)])
    pooled = np.concatenate(errors)
    found = pooled[np.isfinite(pooled)]
    median = float(np.median(found)) if len(found) else float("nan")
    known = len(found) / len(pooled) if len(pooled) else float("nan")
    return Quality(float(np.mean(ratios)), 100 * median, 100 * known)


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


def registered_photos(folder: Path, width: int) -> tuple[Geometry, list[int]]:
    """The pictures of a folder with cameras found from all of them, and which are held out.

    Raises
    ------
    InputError
        If there are no pictures, or they cannot be registered.
    """
    frames = read_capture(folder, "before").frames
    hidden = set(held_out(len(frames)))
    parts: dict[Video, list[Frame]] = {"before": [], "after": []}
    for k, frame in enumerate(frames):  # those held out are a capture of their own
        video: Video = "after" if k in hidden else "before"
        part = parts[video]
        part.append(replace(frame, video=video, index=len(part)))
    captures = [Capture(video, str(folder), tuple(part)) for video, part in parts.items()]
    with tempfile.TemporaryDirectory() as work:
        found = StructureFromMotion(long_side=width)(*captures, Path(work))
    return found, [k for k, view in enumerate(found.views) if view.video == "after"]


def plain(config: TrainConfig) -> dict[str, TrainConfig]:
    """The schedule without its short cuts: every iteration at full size, and with all harmonics."""
    full = replace(config, coarse=())
    return {
        "full size throughout": full,
        "full size, degree 3 from the start": replace(full, degree=3, degree_every=1),
    }


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


def _cpu(action: Callable[[], object], rounds: int) -> float:
    action()  # compiles
    started = time.process_time()
    for _ in range(rounds):
        action()
    return (time.process_time() - started) / rounds


def shares(gaussians: Gaussians, camera: PinholeCamera, rounds: int = 5) -> dict[str, float]:
    """CPU seconds that each step of an iteration takes."""
    steps = iteration_steps(gaussians, camera)
    return {name: _cpu(step, rounds) for name, step in steps.items()}


def iteration_steps(gaussians: Gaussians, camera: PinholeCamera) -> dict[str, Callable[[], object]]:
    """The steps of an iteration, each ready to be done again and again."""
    leaves = gaussians.map(lambda t: t.clone().requires_grad_())
    nothing, still = gaussians.means.new_zeros((len(gaussians), 0)), torch.zeros(len(gaussians), 2)
    picture = torch.rand(3, camera.height, camera.width)
    target = Target.of(torch.rand(picture.shape))
    adam, rates = (
        Adam.start(gaussians),
        {name: np.full(getattr(gaussians, name)[0].numel(), 1e-9) for name in NAMES},
    )
    drawn = render(leaves, camera)
    seed = torch.rand_like(drawn.rgb)
    everything = torch.ones(len(gaussians), dtype=torch.bool)
    torch.autograd.backward(drawn.rgb, seed, retain_graph=True)

    def loss() -> None:
        photometric_loss(picture.requires_grad_(), target).backward()

    return {
        "projection and lists": lambda: _project(gaussians, nothing, still, camera, 2),
        "whole rendering": lambda: render(gaussians, camera),
        "backward": lambda: torch.autograd.backward(drawn.rgb, seed, retain_graph=True),
        "loss": loss,
        "Adam": lambda: adam.step(leaves, rates, everything, 1),
    }


def speed() -> None:
    """Print what an iteration costs."""
    print(" Gaussians     pixels   CPU ms  iterations/s of one core   steps (ms)")
    for count in (10_000, 30_000, 50_000):
        for factor in (2, 1, 0.5):
            gaussians, camera = wall_of_gaussians(count)
            camera = camera.resized(round(240 / factor), round(320 / factor))
            cost = shares(gaussians, camera)
            total = sum(cost.values()) - cost["projection and lists"]
            steps = ", ".join(f"{name} {1000 * s:.1f}" for name, s in cost.items())
            size = f"{camera.width}x{camera.height}"
            print(f"{count:10d} {size:>10} {1000 * total:8.1f} {1 / total:12.1f}   {steps}")


@dataclass(frozen=True)
class Options:
    """Quality and speed of Gaussian splatting."""

    speed: bool = False
    """Only what an iteration costs."""
    plain: bool = False
    """Also train without what makes an iteration cheap."""
    photos: Path | None = None
    """A folder of pictures of one place instead of rendered ones."""
    pair: Path | None = None
    """A rendered pair (`data_tools.synthetic_pairs`) instead of the one that is made."""
    frames: int = 24
    width: int = 320
    start: Start = "stereo"
    most: int = 20_000
    """Points to start from."""
    train: TrainConfig = field(default_factory=TrainConfig)


def main(options: Options) -> None:
    """Print the figures."""
    if options.speed:
        speed()
        return
    geometry, truth, hidden = measured_capture(options)
    shown = [i for i in range(len(truth)) if i not in hidden]
    seen = part_of(geometry, shown)
    began = time.monotonic()
    points = starting_points(seen, options.start, options.most)
    print(f"{len(shown)} views of {seen.views[0].shape[1]}x{seen.views[0].shape[0]}")
    print(f"{len(points.xyz)} points from {options.start}: {time.monotonic() - began:.0f} s")

    def report(at: TrainProgress) -> None:
        if at.iteration % 100 == 0:
            print(at, flush=True)

    runs = {"as configured": options.train, **(plain(options.train) if options.plain else {})}
    for title, config in runs.items():
        result, cost = trained(seen, points, config, report)
        print(f"{title}: {cost.cpu_s:.3f} CPU s an iteration, {cost.wall_s:.0f} s in all")
        rows = [("trained on", shown), ("held out", hidden), ("held out, inside", hidden[1:])]
        for name, chosen in rows:
            views, depths = [geometry.views[i] for i in chosen], [truth[i] for i in chosen]
            print(f"{name:>16}: {quality(result.gaussians, views, depths)}", flush=True)
    print(f"{time.process_time():.0f} CPU s in all")


def measured_capture(options: Options) -> tuple[Geometry, Truth, list[int]]:
    """Views with cameras, their true depth (NaN where none is known), and which are held out."""
    if options.photos is not None:
        geometry, hidden = registered_photos(options.photos, options.width)
        return geometry, tuple(np.full_like(v.depth, np.nan) for v in geometry.views), hidden
    with tempfile.TemporaryDirectory() as folder:
        pair = options.pair
        if pair is None:
            spec = PairSpec(
                "splatting", 77, options.frames, options.width, options.width * 3 // 4,
                texture_size=1024, close=True,
            )  # fmt: skip
            write_pair(spec, Path(folder))
            pair = Path(folder) / spec.name
        geometry, truth = rendered_capture(pair, width=options.width)
    return geometry, truth, held_out(len(truth))


def test_a_rendered_room_is_learned_and_costs_are_counted() -> None:
    geometry, depths = room(36, 48, 9)
    assert held_out(9) == [0, 8]
    shown = part_of(geometry, range(1, 8))
    measured = tuple(
        replace(v, depth=d, measured=np.isfinite(d))
        for v, d in zip(shown.views, depths[1:8], strict=True)
    )
    points = Points.of(replace(shown, views=measured), most=2500)
    sparse = starting_points(shown, "sparse", 0)
    assert len(sparse.xyz) == len(np.unique(shown.points.observations[:, 0]))
    config = TrainConfig(iterations=120, degree=0, densify=None)
    result, cost = trained(shown, points, config)
    known = quality(result.gaussians, shown.views[3:4], depths[4:5])
    assert known.psnr > 22
    assert known.depth_error < 2
    assert known.depth_known > 95
    assert 0 < cost.cpu_s < 10
    assert cost.wall_s > 0


def test_the_wall_is_covered_and_its_steps_take_time() -> None:
    gaussians, camera = wall_of_gaussians(400)
    small = camera.resized(24, 32)
    assert float(render(gaussians, small).alpha.mean()) > 0.8
    cost = shares(gaussians, small, rounds=1)
    assert set(cost) == {"projection and lists", "whole rendering", "backward", "loss", "Adam"}
    assert min(cost.values()) >= 0


if __name__ == "__main__":
    try:
        main(tyro.cli(Options))
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
