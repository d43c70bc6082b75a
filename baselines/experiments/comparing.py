"""Two runs against each other: what differs, by how much, and on which pairs."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from baselines.experiments.chosen import Chosen, opened
from baselines.experiments.config import ExperimentConfig
from baselines.experiments.intervals import Difference, paired_difference
from baselines.experiments.typed import read_as
from data_tools.benchmarks.benchmark import BenchmarkPair
from scenediff_classic.errors import InputError
from scenediff_classic.terminal import shown


@dataclass(frozen=True)
class Compared:
    """A method in a setting on a benchmark, in both runs."""

    method: str
    setting: str
    benchmark: str
    headings: dict[str, str]
    pairs: tuple[str, ...]
    """The pairs that both runs have."""
    differences: dict[str, Difference]
    """By the benchmark's keys; positions in them are of `pairs`."""


@dataclass(frozen=True)
class _Run:
    folder: Path
    config: ExperimentConfig
    cells: dict[tuple[str, str, str], dict[str, dict[str, Any]]]
    """(setting, method, benchmark) -> pair -> entry of ``cells.json``."""

    @staticmethod
    def read(folder: Path) -> "_Run":
        try:
            about = json.loads((folder / "experiment.json").read_text(encoding="utf-8"))
            cells = json.loads((folder / "cells.json").read_text(encoding="utf-8"))
            content = _untyped(about["config"])
            grouped: dict[tuple[str, str, str], dict[str, dict[str, Any]]] = {}
            for cell in cells:
                key = cell["setting"], cell["method"], cell["benchmark"]
                grouped.setdefault(key, {})[cell["pair"]] = cell
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{folder} is not the folder of a finished experiment: give one that "
                "`scenediff-experiments run` has written."
            ) from error
        return _Run(folder, read_as(ExperimentConfig, content, str(folder)), grouped)

    def output(self, key: tuple[str, str, str], pair: str) -> Path | None:
        """Output folder of a cell; None if it failed."""
        cell = self.cells[key][pair]
        return self.folder / cell["output"] if cell["status"] == "done" else None


def compare(
    first: Path, second: Path, judging: Callable[[str], None] = lambda what: None
) -> list[Compared]:
    """Every method, setting and benchmark that both runs have, on the pairs that both have.

    Parameters
    ----------
    first, second : Path
        Folders of experiments; the first one's benchmarks are opened to judge both.
    judging : callable
        Told what is being judged.

    Raises
    ------
    InputError
        If a folder is no experiment's, or the two have nothing in common.
    """
    a, b = _Run.read(first), _Run.read(second)
    benchmarks = {c.benchmark.name: c for c in opened(a.config.benchmarks)}
    out = []
    for key in a.cells:
        if key not in b.cells or key[2] not in benchmarks:
            continue
        found = _compared(a, b, key, benchmarks[key[2]], judging)
        if found is not None:
            out.append(found)
    if not out:
        raise InputError(f"{first} and {second} have no method, setting and pair in common.")
    return out


def _compared(
    a: _Run, b: _Run, key: tuple[str, str, str], chosen: Chosen, judging: Callable[[str], None]
) -> Compared | None:
    names = [name for name in a.cells[key] if name in b.cells[key]]
    pairs: dict[str, BenchmarkPair] = {p.name: p for p in chosen.pairs if p.name in names}
    if not pairs:
        return None
    setting, method, benchmark = key
    judging(f"{setting} / {method} / {benchmark}")
    judged = [
        [chosen.benchmark.judge(pair, run.output(key, name)) for name, pair in pairs.items()]
        for run in (a, b)
    ]
    differences = paired_difference(
        chosen.benchmark, *judged, draws=a.config.draws, seed=a.config.seed
    )
    headings = dict(chosen.benchmark.metrics)
    return Compared(method, setting, benchmark, headings, tuple(pairs), differences)


def compared_tables(found: list[Compared]) -> Iterator[Table]:
    """One for each method, setting and benchmark, in percent."""
    for item in found:
        title = f"{item.setting} / {item.method} / {item.benchmark}, {len(item.pairs)} pairs"
        table = Table(title=shown(f"{title} (percent)"))
        for name in ("figure", "first", "second", "difference", "95 % interval"):
            table.add_column(name, justify="left" if name == "figure" else "right")
        table.add_column("pairs better")
        table.add_column("pairs worse")
        for key, d in item.differences.items():
            interval = (
                "" if d.interval is None else " to ".join(f"{100 * v:+.1f}" for v in d.interval)
            )
            style = "bold" if d.clear else ""
            table.add_row(
                shown(item.headings.get(key, key)), _percent(d.first), _percent(d.second),
                _percent(d.difference, "+"), interval,
                shown(_listed(item.pairs, d.better)), shown(_listed(item.pairs, d.worse)),
                style=style,
            )  # fmt: skip
        yield table


def as_json(found: list[Compared], first: Path, second: Path) -> dict[str, Any]:
    """Everything of a comparison, for other programs."""
    return {
        "schema": 1,
        "first": str(first),
        "second": str(second),
        "compared": [
            {
                "method": item.method,
                "setting": item.setting,
                "benchmark": item.benchmark,
                "headings": item.headings,
                "pairs": list(item.pairs),
                "differences": {
                    key: {
                        "first": d.first,
                        "second": d.second,
                        "difference": d.difference,
                        "interval": d.interval,
                        "better": [item.pairs[i] for i in d.better],
                        "worse": [item.pairs[i] for i in d.worse],
                    }
                    for key, d in item.differences.items()
                },
            }
            for item in found
        ],
    }


def _percent(value: float | None, sign: str = "") -> str:
    return "-" if value is None else f"{100 * value:{sign}.1f}"


def _listed(pairs: tuple[str, ...], positions: tuple[int, ...]) -> str:
    names = [pairs[i] for i in positions]
    return ", ".join(names) if len(names) <= 6 else f"{', '.join(names[:5])}, {len(names) - 5} more"


def _untyped(value: Any) -> Any:
    """A configuration as `json_ready` wrote it, without the names of classes and what was unset."""
    if isinstance(value, dict):
        return {k: _untyped(v) for k, v in value.items() if k != "type" and v is not None}
    return [_untyped(v) for v in value] if isinstance(value, list) else value
