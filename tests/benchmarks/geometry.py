"""How the cost of geometry grows with the number of frames, stage by stage.

``python -m tests.benchmarks.geometry`` renders one room in captures of 10, 20, 40 and 80 frames,
finds cameras and depth from the pictures, each in a process of its own, and prints CPU seconds by
stage, peak memory, accuracy, and the exponent with which time grows.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import tyro

from data_tools.benchmarks.registration import compare_cameras
from data_tools.synthetic_pairs.export import write_pair
from data_tools.synthetic_pairs.scene import PairSpec
from scenediff_classic.cameras import camera_centre
from scenediff_classic.geometry.from_pictures import GeometryFromPictures
from scenediff_classic.presets import Preset, configured
from scenediff_classic.types import VIDEOS, Geometry
from scenediff_classic.video import read_capture


@dataclass
class Stopwatch:
    """A progress callback that counts CPU seconds by stage."""

    seconds: dict[str, float] = field(default_factory=dict)
    _stage: str | None = None
    _since: float = field(default_factory=time.process_time)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Time since the last call is of the stage that was under way, else of this one."""
        now = time.process_time()
        owner = self._stage or stage
        self.seconds[owner] = self.seconds.get(owner, 0.0) + now - self._since
        self._stage, self._since = (None if total and done >= total else stage), now


@dataclass(frozen=True)
class Figures:
    """One row of the table."""

    frames: int
    """Of each capture."""
    width: int
    height: int
    registered: int
    seconds: dict[str, float]
    """CPU seconds by stage."""
    peak_gib: float
    centre: float
    """Median error of the camera centres, percent of the path's extent."""
    measured: float
    """Percent of the pixels that have confirmed depth."""
    within_2: float
    """Percent of those within 2 % of the truth."""

    @property
    def total(self) -> float:
        """CPU seconds of all stages."""
        return sum(self.seconds.values())


def measure(pair: Path, preset: Preset, width: int) -> Figures:
    """Geometry of one rendered pair from its pictures."""
    watch = Stopwatch()
    captures = [read_capture(pair / video, video) for video in VIDEOS]
    estimator = configured(preset, long_side=width).geometry
    assert isinstance(estimator, GeometryFromPictures)
    with tempfile.TemporaryDirectory() as folder:
        geometry = estimator(captures[0], captures[1], Path(folder), watch)
    watch("completion", 1, 1)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    centre, measured, within = accuracy(geometry, pair)
    height, width = geometry.views[0].shape
    return Figures(
        len(captures[0].frames), width, height, len(geometry.views), watch.seconds, peak, centre,
        measured, within,
    )  # fmt: skip


def accuracy(geometry: Geometry, pair: Path) -> tuple[float, float, float]:
    """Centre error (% of extent), share measured (%), share of that within 2 % (%)."""
    with np.load(pair / "truth_geometry.npz") as stored:
        known = {
            (VIDEOS[v], int(i)): n
            for n, (v, i) in enumerate(zip(stored["video"], stored["index"], strict=True))
        }
        rows = [known[view.key] for view in geometry.views]
        poses, depth = stored["cam_from_world"][rows], stored["depth"][rows]
    found = np.stack([view.cam_from_world for view in geometry.views])
    errors = compare_cameras(found, poses)
    spread = [np.std([camera_centre(p) for p in some], axis=0) for some in (poses, found)]
    scale = float(np.linalg.norm(spread[0]) / np.linalg.norm(spread[1]))
    right, measured = [], []
    for view, true in zip(geometry.views, depth, strict=True):
        step = true.shape[0] / view.shape[0], true.shape[1] / view.shape[1]
        rows, cols = (
            ((np.arange(n) + 0.5) * s).astype(int) for n, s in zip(view.shape, step, strict=True)
        )
        there = true[rows[:, None], cols[None, :]]
        measured.append(view.measured.mean())
        right.append(np.abs(view.depth * scale / there - 1)[view.measured] < 0.02)
    centre = 100 * float(np.median(errors.centre)) / errors.extent
    return centre, 100 * float(np.mean(measured)), 100 * float(np.mean(np.concatenate(right)))


def exponent(frames: list[int], seconds: list[float]) -> float:
    """The power of the number of frames with which time grows, by least squares in logarithms."""
    return float(np.polyfit(np.log(frames), np.log(seconds), 1)[0])


@dataclass(frozen=True)
class Options:
    """Cost and accuracy of geometry against the number of frames."""

    frames: tuple[int, ...] = (10, 20, 40, 80)
    """Frames of each capture."""
    width: int = 320
    height: int = 240
    preset: Preset = "balanced"
    folder: Path | None = None
    """Where the rendered captures are kept; a temporary folder if left out."""
    only: Path | None = None
    """Measure this pair in this process and print its figures as JSON."""


def main(options: Options) -> None:
    """Print the table."""
    if options.only is not None:
        figures = measure(options.only, options.preset, max(options.width, options.height))
        print(json.dumps(vars(figures)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        root = options.folder or Path(temporary)
        rows = [_in_own_process(options, _rendered(root, n, options)) for n in options.frames]
    stages = sorted({stage for row in rows for stage in row.seconds})
    print("CPU seconds for both captures; peak memory; accuracy against the truth")
    print("frames  size     " + "".join(f"{s:>14}" for s in stages), end="")
    print("     total  a frame  Mpx/s  GiB  placed  centre %  measured %  <2 % %")
    for row in rows:
        views = row.registered
        print(
            f"2 x {row.frames:<3} {row.width}x{row.height}  "
            + "".join(f"{row.seconds.get(s, 0.0):14.1f}" for s in stages)
            + f"{row.total:10.1f}{row.total / views:9.2f}"
            + f"{views * row.width * row.height / row.total / 1e6:7.3f}{row.peak_gib:6.2f}"
            + f"{views:5}/{2 * row.frames:<3}{row.centre:8.3f}{row.measured:12.1f}"
            + f"{row.within_2:8.1f}"
        )
    if len(rows) > 1:
        counts = [row.frames for row in rows]
        grown = {s: [row.seconds.get(s, 0.0) for row in rows] for s in stages}
        print("\ntime grows with the number of frames to the power of")
        for stage, seconds in {**grown, "total": [row.total for row in rows]}.items():
            if min(seconds) > 0:
                print(f"{stage:>14} {exponent(counts, seconds):5.2f}")


def _rendered(root: Path, frames: int, options: Options) -> Path:
    name = f"room_{options.width}x{options.height}_{frames:03d}"
    spec = PairSpec(name, 77, frames, options.width, options.height, close=True)
    write_pair(spec, root)
    return root / name


def _in_own_process(options: Options, pair: Path) -> Figures:
    command = [
        sys.executable, "-m", __spec__.name, "--only", str(pair), "--preset", options.preset,
        "--width", str(options.width), "--height", str(options.height),
    ]  # fmt: skip
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return Figures(**json.loads(done.stdout.splitlines()[-1]))


def test_time_is_of_the_stage_under_way(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = iter([0.0, 1.0, 3.0, 6.0, 10.0])
    monkeypatch.setattr(time, "process_time", lambda: next(ticks))
    watch = Stopwatch(_since=next(ticks))
    watch("matching", 0, 2)  # what came before is of the first stage
    watch("matching", 2, 2)
    watch("stereo", 0, 1)  # matching was done: this is of stereo
    watch("stereo", 1, 1)
    assert watch.seconds == {"matching": 3.0, "stereo": 7.0}


def test_exponent_of_a_square_is_two() -> None:
    assert exponent([10, 20, 40], [5.0, 20.0, 80.0]) == pytest.approx(2.0)


@pytest.mark.slow
def test_geometry_of_a_short_capture(tmp_path: Path) -> None:
    pair = _rendered(tmp_path, 6, Options())
    figures = measure(pair, "fast", 320)
    print(figures)
    assert figures.registered == 12
    assert figures.centre < 0.5
    assert figures.measured > 30
    assert figures.within_2 > 80
    assert {"features", "matching", "camera poses", "stereo"} <= figures.seconds.keys()


if __name__ == "__main__":
    main(tyro.cli(Options))
