"""Figures of every method in every setting; judged again only where answers or truth changed."""

import json
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from baselines.experiments.cells import Cell
from baselines.experiments.chosen import Chosen
from baselines.experiments.intervals import bootstrap
from baselines.experiments.store import Fingerprints, read_json
from baselines.experiments.tasks import Outcome
from data_tools.benchmarks.benchmark import Benchmark
from data_tools.benchmarks.stages import digest
from scenediff_classic.result.run import json_ready
from scenediff_classic.workspace import write_atomic

Answer = tuple[Cell, Outcome]


def scored(
    answers: Sequence[Answer],
    benchmarks: Sequence[Chosen],
    folder: Path,
    prints: Fingerprints,
    *,
    draws: int,
    seed: int,
    again: bool = False,
    judging: Callable[[str], None] = lambda what: None,
) -> list[dict[str, Any]]:
    """The entries of ``scores.json``.

    Parameters
    ----------
    answers : sequence
        Cells, and how they ended; one that failed counts as the benchmark counts a miss.
    folder : Path
        Where finished entries are kept.
    again : bool
        Judge even what is kept.
    judging : callable
        Told what is being judged.
    """
    by_name = {c.benchmark.name: c for c in benchmarks}
    groups: dict[tuple[str, str, str], list[Answer]] = {}
    for cell, outcome in answers:
        groups.setdefault((cell.method, cell.setting, cell.benchmark), []).append((cell, outcome))
    entries = []
    for (method, setting, name), own in groups.items():
        chosen = by_name[name]
        head = {"method": method, "setting": setting, "benchmark": name}
        path = folder / f"{_key(own, chosen, prints, draws, seed)}.json"
        kept = None if again else read_json(path)
        if kept is None:
            judging(f"{setting} / {method} / {name}")
            kept = _figures(own, chosen.benchmark, draws, seed)
            write_atomic(path, json.dumps(kept) + "\n")
        entries.append({**head, **kept})
    return entries


def judged(own: Sequence[Answer], benchmark: Benchmark[Any]) -> list[Any]:
    """What the benchmark keeps of every answer."""
    return [
        benchmark.judge(
            cell.pair, cell.task.out if cell.task and outcome.status == "done" else None
        )
        for cell, outcome in own
    ]


def _figures(
    own: Sequence[Answer], benchmark: Benchmark[Any], draws: int, seed: int
) -> dict[str, Any]:
    evidence = judged(own, benchmark)
    members: dict[str, list[Any]] = {}
    for (cell, _), item in zip(own, evidence, strict=True):
        if cell.pair.group:
            members.setdefault(cell.pair.group, []).append(item)
    alone = {
        cell.pair.name: benchmark.pool([item])
        for (cell, _), item in zip(own, evidence, strict=True)
    }
    return {
        "metrics": benchmark.pool(evidence),
        "headings": dict(benchmark.metrics),
        "groups": {group: benchmark.pool(items) for group, items in members.items()},
        "intervals": bootstrap(benchmark, evidence, draws=draws, seed=seed),
        "pairs": alone,
    }


def _key(own: Sequence[Answer], chosen: Chosen, prints: Fingerprints, draws: int, seed: int) -> str:
    parts = [
        (
            cell.pair.name, cell.pair.group, cell.task.key if cell.task else None, outcome.status,
            prints.tree(cell.pair.truth) if cell.pair.truth else None,
        )
        for cell, outcome in own
    ]  # fmt: skip
    spec = chosen.spec
    program = version("scenediff-classic")
    return digest(parts, spec.kind, json_ready(spec.options), draws, seed, program)
