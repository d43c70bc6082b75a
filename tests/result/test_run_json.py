"""``run.json``, and configurations as JSON."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenediff_classic.result import RunInfo, json_ready, write_run


@dataclass(frozen=True)
class Inner:
    path: Path
    sizes: tuple[int, ...]


@dataclass(frozen=True)
class Outer:
    inner: Inner
    ratio: float
    rest: float = math.inf


def test_configurations_become_json() -> None:
    config = Outer(Inner(Path("a") / "b", (1, 2)), np.float64(0.5))
    assert json_ready(config) == {
        "type": "Outer",
        "inner": {"type": "Inner", "path": str(Path("a") / "b"), "sizes": [1, 2]},
        "ratio": 0.5,
        "rest": "inf",
    }


def test_run_json(tmp_path: Path) -> None:
    info = RunInfo(
        command=("scenediff-classic", "detect"),
        config={"seed": 3},
        versions={"numpy": "2"},
        seed=3,
        stage_seconds={"geometry": 1.5, "scores": 0.25},
        peak_memory_bytes=1024,
        fingerprint={"before": "abc"},
    )
    write_run(info, tmp_path / "run.json")
    assert json.loads((tmp_path / "run.json").read_text("utf-8")) == {
        "schema": 1,
        "command": ["scenediff-classic", "detect"],
        "config": {"seed": 3},
        "versions": {"numpy": "2"},
        "seed": 3,
        "stage_seconds": {"geometry": 1.5, "scores": 0.25},
        "peak_memory_bytes": 1024,
        "git_commit": None,
        "fingerprint": {"before": "abc"},
    }
