"""A benchmark of tiny noisy pictures, and a method that answers at once, or as told."""

import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from baselines.registry import Method
from data_tools.benchmarks.benchmark import BenchmarkPair
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.errors import AlignmentError
from scenediff_classic.geometry.from_pictures import GeometryFromPictures
from scenediff_classic.protocols import GeometryEstimator, Progress
from scenediff_classic.types import (
    Capture,
    ChangeResult,
    Evidence,
    FrameInfo,
    ScoreMaps,
    VideoInfo,
)

HERE = "tests.baselines.experiments.fakes"


def write_pairs(root: Path, count: int) -> Path:
    """Pairs of one picture and one picture each, with known geometry."""
    rng = np.random.default_rng(0)
    lens = np.array([[64.0, 0, 32], [0, 64, 24], [0, 0, 1]])
    for k in range(count):
        folder = root / f"pair_{k}"
        for video in ("before", "after"):
            (folder / video).mkdir(parents=True)
            picture = rng.integers(0, 255, (48, 64, 3), np.uint8)
            cv2.imwrite(str(folder / video / "0000.png"), picture)
        np.savez(
            folder / "known.npz",
            intrinsics=np.stack([lens, lens]),
            cam_from_world=np.stack([np.eye(4), np.eye(4)]),
            depth=np.full((2, 48, 64), 2.0, np.float32),
        )
    return root


@dataclass(frozen=True)
class FakeBenchmark:
    """Scores an answer by its scale; a missing one by 0."""

    root: Path
    name: str = "fake"

    @property
    def metrics(self) -> Mapping[str, str]:
        """One figure."""
        return {"level": "Level"}

    def pairs(self) -> tuple[BenchmarkPair, ...]:
        """In the order of their names."""
        return tuple(
            BenchmarkPair(
                p.name, CaptureOptions(p / "before"), CaptureOptions(p / "after"),
                group="even" if int(p.name[-1]) % 2 == 0 else "odd",
                known_geometry=p / "known.npz",
            )
            for p in sorted(self.root.glob("pair_*"))
        )  # fmt: skip

    def problems(self) -> tuple[str, ...]:
        """None."""
        return ()

    def judge(self, pair: BenchmarkPair, run: Path | None) -> float:
        """See the class."""
        return (
            0.0 if run is None else float(json.loads((run / "changes.json").read_bytes())["scale"])
        )

    def pool(self, judged: Sequence[float]) -> dict[str, float | None]:
        """The mean."""
        return {"level": float(np.mean(judged)) if judged else None}


def open_fake(root: Path, name: str = "fake") -> FakeBenchmark:
    """As `open_benchmark`."""
    return FakeBenchmark(root, name)


@dataclass(frozen=True)
class FakeConfig:
    """What the method is to do."""

    geometry: GeometryEstimator = field(default_factory=GeometryFromPictures)
    level: float = 0.5
    fails_on: str = ""
    """Name of a pair."""
    breaks_on: str = ""
    dies_on: str = ""
    dies_once: bool = False
    takes_s: float = 0.0
    diary: str = ""
    """File that gets a line for every pair that is finished."""


def _detect(
    before: Capture, after: Capture, config: FakeConfig, *, workspace: Path, progress: Progress
) -> tuple[ChangeResult, Evidence]:
    pair = Path(before.source).parent.name
    geometry = config.geometry(before, after, workspace, progress)
    time.sleep(config.takes_s)
    if pair == config.fails_on:
        raise AlignmentError("The captures do not overlap.")
    if pair == config.breaks_on:
        raise ZeroDivisionError("an error of the program")
    if pair == config.dies_on:
        mark = Path(config.diary).with_name("died")
        if not (config.dies_once and mark.exists()):
            mark.touch()
            os._exit(3)
    if config.diary:
        with Path(config.diary).open("a") as file:
            file.write(f"{pair}\n")
    infos = [
        VideoInfo(
            c.source,
            tuple(
                FrameInfo(f.index, f.name, None, f.width, f.height, True, None) for f in c.frames
            ),
        )
        for c in (before, after)
    ]
    maps = tuple(ScoreMaps(*(np.zeros(v.shape, np.float32),) * 4) for v in geometry.views)
    result = ChangeResult(infos[0], infos[1], (), None, config.level)
    return result, Evidence(geometry, maps, ((0, 1),), {"geometry": 0.0, "guess": 0.25})


METHOD = Method(lambda base, seed: FakeConfig(geometry=base.geometry), _detect)

CONFIG = """
name = "fake"
draws = 20
[[benchmarks]]
kind = "{here}:open_fake"
root = "{root}"
[[methods]]
name = "calm"
method = "{here}:METHOD"
options = {{ diary = "{diary}"{calm} }}
[[methods]]
name = "other"
method = "{here}:METHOD"
options = {{ diary = "{diary}", level = 0.75{other} }}
[[settings]]
name = "known"
geometry = "known"
"""


def write_config(folder: Path, count: int = 3, calm: str = "", other: str = "") -> Path:
    """An experiment of two fake methods; further options as TOML."""
    pairs = folder / "pairs"
    if not pairs.exists():
        write_pairs(pairs, count)
    path = folder / "fake.toml"
    diary = folder / "diary.txt"
    more = {"calm": calm and f", {calm}", "other": other and f", {other}"}
    path.write_text(CONFIG.format(here=HERE, root=pairs, diary=diary, **more))
    return path


def done(folder: Path) -> list[str]:
    """Pairs that a method has finished so far, in order."""
    diary = folder / "diary.txt"
    return diary.read_text().split() if diary.exists() else []


def read(path: Path) -> Any:
    """A JSON file."""
    return json.loads(path.read_bytes())
