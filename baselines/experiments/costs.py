"""What methods cost: seconds by stage, and the highest memory."""

from collections.abc import Sequence
from statistics import fmean, median

from baselines.experiments.comparisons import about
from baselines.experiments.finished import Cell, FinishedRun
from baselines.experiments.tables import NOTHING, Column, Table, Value, number, texts

_GB = 1e9


def runtime_table(run: FinishedRun, benchmark: str) -> Table:
    """Seconds a pair and peak memory of every method under every setting."""
    rows = []
    for setting, method in run.variants(benchmark):
        cells = _done(run, benchmark, setting, method)
        seconds = [cell.seconds for cell in cells]
        memory = [c.peak_memory_bytes for c in cells if c.peak_memory_bytes is not None]
        rows.append(
            texts(
                method, setting, len(cells),
                number(fmean(seconds)) if seconds else NOTHING,
                number(median(seconds)) if seconds else NOTHING,
                number(max(seconds)) if seconds else NOTHING,
                number(max(memory), 2, 1 / _GB) if memory else NOTHING,
            )
        )  # fmt: skip
    names = ("method", "setting", "pairs", "mean s", "median s", "longest s", "peak memory GB")
    columns = [Column(name, number=name not in ("method", "setting")) for name in names]
    return Table(
        f"runtime-{benchmark}", "Time and memory", about(run, benchmark, _machine(run)),
        tuple(columns), tuple(rows),
        ("Wall clock of one pair, its stages added up, as each was first computed: work that "
         "methods share is counted for each of them. Peak memory is the largest over the pairs of "
         "the process that ran them.",),
    )  # fmt: skip


def stage_table(run: FinishedRun, benchmark: str) -> Table | None:
    """Mean seconds of every stage; None where no stage was recorded."""
    columns = run.variants(benchmark)
    found = {key: _done(run, benchmark, *key) for key in columns}
    stages = dict.fromkeys(s for cells in found.values() for c in cells for s in c.stage_seconds)
    if not stages:
        return None
    several = len({setting for setting, _ in columns}) > 1
    rows = []
    for setting, method in columns:
        cells = found[setting, method]
        values = (Value(_mean_stage(cells, stage)) for stage in stages)
        rows.append((Value(f"{method}, {setting}" if several else method), *values))
    return Table(
        f"stages-{benchmark}", "Mean seconds by stage", about(run, benchmark, _machine(run)),
        (Column("method", number=False), *(Column(stage) for stage in stages)), tuple(rows),
        (f"Means over the pairs that have the stage. {NOTHING} = the method has no such stage.",),
    )  # fmt: skip


def _done(run: FinishedRun, benchmark: str, setting: str, method: str) -> list[Cell]:
    return [
        cell for cell in run.cells
        if cell.done and (cell.benchmark, cell.setting, cell.method) == (benchmark, setting, method)
    ]  # fmt: skip


def _mean_stage(cells: Sequence[Cell], stage: str) -> str:
    seconds = [cell.stage_seconds[stage] for cell in cells if stage in cell.stage_seconds]
    return number(fmean(seconds), 1 if fmean(seconds) >= 0.1 else 2) if seconds else NOTHING


def _machine(run: FinishedRun) -> str:
    machine = run.about.get("machine")
    if not isinstance(machine, dict):
        return "machine not recorded"
    return f"{machine.get('cpu') or 'unknown processor'}, {machine.get('cores', '?')} cores"
