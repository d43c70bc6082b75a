"""The pieces of work of an experiment: what every worker runs, on this machine or another."""

import json
import resource
import shutil
import sys
import time
import traceback
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from baselines.experiments.store import (
    Ledger,
    Stopwatch,
    pair_stages,
    read_json,
    shared,
)
from baselines.registry import load_method
from data_tools.benchmarks.benchmark import BenchmarkPair
from scenediff_classic.detection_run import run_detection
from scenediff_classic.errors import OutputError, SceneDiffError
from scenediff_classic.geometry.store import SavedGeometry
from scenediff_classic.protocols import GeometryEstimator, Progress, silent
from scenediff_classic.types import Capture, ChangeResult, Evidence
from scenediff_classic.workspace import write_atomic

GEOMETRY = "estimating"
"""Name of the folder for unfinished geometry in the store."""


@dataclass(frozen=True)
class Prepare:
    """Find the geometry of a pair, for all methods."""

    key: str
    label: str
    pair: BenchmarkPair
    identity: tuple[str, ...]
    source: GeometryEstimator
    store: Path

    @property
    def folder(self) -> Path:
        """Where the geometry is once it is finished."""
        return pair_stages(self.pair, self.identity, self.store).geometry_folder(self.source)

    @property
    def cost(self) -> Path:
        """What it took."""
        return self.folder.with_name(self.folder.name + ".json")


@dataclass(frozen=True)
class Detect:
    """Run a method on a pair, given its geometry."""

    key: str
    label: str
    prepare: Prepare
    method: str
    config: Any
    """The method's own options, with the source of geometry in them."""
    seed: int
    share: tuple[str, ...]
    out: Path
    """The output folder."""
    record: Path
    """Where the outcome is written, before anyone is told of it."""


Task = Prepare | Detect


@dataclass(frozen=True)
class Outcome:
    """How a task ended."""

    status: Literal["done", "failed"]
    reason: str | None = None
    """One sentence."""
    final: bool = True
    """Whether the same call would end in the same way."""
    stage_seconds: dict[str, float] = field(default_factory=dict)
    peak_memory_bytes: int | None = None


def perform(task: Task, progress: Progress = silent) -> Outcome:
    """Do a task; whatever goes wrong in it becomes its outcome."""
    with suppress(OSError):  # on Linux: peak memory counts from now on
        Path("/proc/self/clear_refs").write_text("5")
    try:
        if isinstance(task, Prepare):
            return _prepare(task, progress)
        kept = read_outcome(task)
        if kept is not None and kept.status == "done":
            return kept  # by a worker that was lost before it could say so
        outcome = _detect(task, progress)
        write_outcome(task, outcome)
        return outcome
    except SceneDiffError as error:
        final = not isinstance(error, OutputError)  # a full disk, say, may be emptied
        return Outcome("failed", " ".join(str(error).split()), final)
    except Exception as error:
        traceback.print_exc(file=sys.stderr)
        words = " ".join(str(error).split()) or "no message"
        return Outcome("failed", f"{type(error).__name__}: {words}", final=False)


def _prepare(task: Prepare, progress: Progress) -> Outcome:
    if SavedGeometry.found_in(task.folder) and task.cost.is_file():
        return Outcome("done")
    clock = Stopwatch(task.cost)
    start = time.perf_counter()
    stages = pair_stages(task.pair, task.identity, task.store, clock.watching(progress))
    workspace = f"{GEOMETRY}-{task.key}"
    stages.geometry(task.source, workspace)
    peak = peak_memory()
    clock.write(peak_memory_bytes=peak)
    shutil.rmtree(task.folder.with_name(workspace), ignore_errors=True)
    return Outcome("done", None, True, {"geometry": time.perf_counter() - start}, peak)


def peak_memory() -> int:
    """Of this process, in bytes."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _detect(task: Detect, progress: Progress) -> Outcome:
    method = load_method(task.method)
    prepare = task.prepare
    ledger = Ledger()
    given = replace(task.config, geometry=SavedGeometry(prepare.folder))
    given = shared(given, task.share, prepare.store, ledger)
    cost = read_json(prepare.cost) or {}

    def detect(
        before: Capture, after: Capture, workspace: Path, progress: Progress
    ) -> tuple[ChangeResult, Evidence]:
        result, evidence = method.detect(
            before, after, given, workspace=workspace, progress=progress
        )
        # what the geometry took belongs to every method that could not do without it
        seconds = {**evidence.stage_seconds, "geometry": cost.get("seconds", 0.0), **ledger.saved}
        return result, replace(evidence, stage_seconds=seconds)

    known = prepare.pair.known_geometry
    uses = (known,) if known is not None and len(prepare.identity) > 2 else ()
    run_detection(
        prepare.pair.before,
        prepare.pair.after,
        task.out,
        detect,
        task.config,
        seed=task.seed,
        overwrite=True,
        uses=(*uses, *method.files(task.config)),
        command=tuple(sys.argv),
        progress=progress,
    )
    run = read_json(task.out / "run.json") or {}
    peaks = [p for p in (run.get("peak_memory_bytes"), cost.get("peak_memory_bytes")) if p]
    return Outcome("done", None, True, run.get("stage_seconds", {}), max(peaks, default=None))


def read_outcome(task: Detect) -> Outcome | None:
    """How this very task ended; None if it did not yet, or what it made is gone."""
    found = read_json(task.record)
    if found is None or found.pop("key", None) != task.key:
        return None
    if found["status"] == "done" and not (task.out / "changes.json").is_file():
        return None
    return Outcome(**found)


def write_outcome(task: Detect, outcome: Outcome) -> None:
    """Keep how a task ended."""
    content = {"key": task.key, **asdict(outcome)}
    write_atomic(task.record, json.dumps(content, indent=1) + "\n")
