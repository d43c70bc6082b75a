"""An experiment from its configuration to its tables."""

import fcntl
import json
import os
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import psutil

from baselines.experiments.cells import Cell, planned
from baselines.experiments.chosen import Chosen, opened
from baselines.experiments.config import ExperimentConfig
from baselines.experiments.driving import Workers, drive
from baselines.experiments.page import write_outputs
from baselines.experiments.scoring import scored
from baselines.experiments.showing import Show
from baselines.experiments.store import Fingerprints, read_json
from baselines.experiments.tasks import Outcome
from data_tools.benchmarks.stages import digest
from scenediff_classic.detection_run import git_commit, versions
from scenediff_classic.errors import OutputError
from scenediff_classic.result.run import json_ready
from scenediff_classic.workspace import write_atomic, writing

Engine = Callable[[Show], AbstractContextManager[Workers]]
"""Starts workers, which tell how far they are."""


@dataclass(frozen=True)
class Report:
    """What a run left behind."""

    run: Path
    cells: int
    """All of them."""
    computed: int
    """Those that were not there before."""
    failed: int
    written: tuple[Path, ...]
    """The page, tables and figures."""


def run_experiment(
    config: ExperimentConfig,
    run: Path,
    store: Path,
    engine: Engine,
    show: Show,
    *,
    retry: bool = False,
    rescore: bool = False,
    command: Sequence[str] = (),
) -> Report:
    """Do what is missing of an experiment, score it, and write its tables and figures.

    Parameters
    ----------
    run : Path
        Folder of the experiment; a second call with it continues.
    store : Path
        What methods and experiments share (see `store`).
    engine : callable
        Where the work is done; asked only if there is any.
    retry : bool
        Try failed cells again.
    rescore : bool
        Judge all answers again and write everything anew.
    command : sequence of str
        What was typed, for the page to say.

    Raises
    ------
    InputError
        If the configuration or a benchmark cannot be used: nothing was computed then.
    OutputError
        If the folders cannot be written, or another call writes to the same one.
    """
    run, store = run.resolve(), store.resolve()
    benchmarks = opened(config.benchmarks)
    with _held(run):
        prints = Fingerprints(store / "fingerprints.json")
        cells = planned(config, benchmarks, run, store, prints)
        prints.save()
        missing = [c.task for c in cells if c.task and (c.outcome() is None or _again(c, retry))]
        started = _now()
        if missing:
            for chosen in benchmarks:
                show.notes(chosen.benchmark.problems())
            _begin(config, benchmarks, run, started, command)
            for task in missing:
                task.record.unlink(missing_ok=True)
            with show.bars(len(missing)), engine(show) as workers:
                drive(missing, workers, show.finished)
        answers = [(cell, _ended(cell)) for cell in cells]
        scores = scored(
            answers, benchmarks, run / "records" / ".judged", prints,
            draws=config.draws, seed=config.seed, again=rescore, judging=show.judging,
        )  # fmt: skip
        prints.save()
        rows = [_row(cell, outcome, run) for cell, outcome in answers]
        _write(config, benchmarks, run, rows, scores, started, command, rescore)
        written: list[Path] = []
        if config.figures:  # what is there and would be the same is left as it is
            if rescore:
                (run / "outputs.json").unlink(missing_ok=True)
            written = write_outputs(run, {c.benchmark.name: c.pairs for c in benchmarks})
    failed = sum(outcome.status == "failed" for _, outcome in answers)
    return Report(run, len(cells), len(missing), failed, tuple(written))


def _again(cell: Cell, retry: bool) -> bool:
    outcome = cell.outcome()
    return retry and outcome is not None and outcome.status == "failed"


def _ended(cell: Cell) -> Outcome:
    return cell.ended() or Outcome("failed", "It was not done.", final=False)


def _row(cell: Cell, outcome: Outcome, run: Path) -> dict[str, Any]:
    """An entry of ``cells.json``."""
    done = outcome.status == "done" and cell.task is not None
    return {
        "method": cell.method,
        "setting": cell.setting,
        "benchmark": cell.benchmark,
        "pair": cell.pair.name,
        "group": cell.pair.group,
        "status": outcome.status,
        "reason": outcome.reason,
        "seconds": float(sum(outcome.stage_seconds.values())),
        "stage_seconds": outcome.stage_seconds,
        "peak_memory_bytes": outcome.peak_memory_bytes,
        "output": str(cell.task.out.relative_to(run)) if done and cell.task else None,
    }


def _write(
    config: ExperimentConfig, benchmarks: Sequence[Chosen], run: Path,
    rows: list[dict[str, Any]], scores: list[dict[str, Any]], started: str,
    command: Sequence[str], again: bool,
) -> None:  # fmt: skip
    """The run's three files; not if they are there and would be the same but for their times."""
    state = run / "records" / ".written.json"
    about = _about(config, benchmarks)
    key = digest(about, rows, scores)
    found = read_json(state)
    if found is not None and found.get("key") == key and not again:
        return
    before = read_json(run / "experiment.json") or {}
    times = {
        "started": before.get("started") or started,
        "finished": _now(),
        "command": list(command),
    }
    _write_json(run / "cells.json", rows)
    _write_json(run / "scores.json", scores)
    _write_json(run / "experiment.json", {**about, **times})
    _write_json(state, {"key": key})


def _begin(
    config: ExperimentConfig,
    benchmarks: Sequence[Chosen],
    run: Path,
    started: str,
    command: Sequence[str],
) -> None:
    before = read_json(run / "experiment.json") or {}
    times = {
        "started": before.get("started") or started,
        "finished": None,
        "command": list(command),
    }
    _write_json(run / "experiment.json", {**_about(config, benchmarks), **times})


def _about(config: ExperimentConfig, benchmarks: Sequence[Chosen]) -> dict[str, Any]:
    return {
        "schema": 1,
        "name": config.name,
        "config": json_ready(config),
        "benchmarks": [c.benchmark.name for c in benchmarks],
        "methods": [m.name for m in config.methods],
        "settings": [s.name for s in config.settings],
        "seed": config.seed,
        "versions": dict(versions()),
        "git_commit": git_commit(),
        "machine": {
            "cpu": _cpu(),
            "cores": os.cpu_count(),
            "memory_bytes": psutil.virtual_memory().total,
            "python": platform.python_version(),
            "platform": platform.platform(),
        },
    }


def _write_json(path: Path, content: Any) -> None:
    write_atomic(path, json.dumps(content, indent=1) + "\n")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _cpu() -> str:
    """Name of the processor, where the system tells it."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


@contextmanager
def _held(run: Path) -> Iterator[None]:
    """The folder for this call alone; refused if it is something else's."""
    with writing(run):
        run.mkdir(parents=True, exist_ok=True)
        if not (run / "records").is_dir() and any(run.iterdir()):
            raise OutputError(
                f"{run} holds other files, which are left alone: choose another folder."
            )
        (run / "records").mkdir(exist_ok=True)
        lock = os.open(run / "records", os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(lock)
            raise OutputError(f"Another call is writing to {run} now: wait for it.") from error
        except OSError:  # some network drives have no locks
            pass
    try:
        yield
    finally:
        os.close(lock)
