"""A finished run as tables and figures read it; see docs/experiments.md for the files."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from scenediff_classic.dataset import records
from scenediff_classic.errors import InputError

Figures = Mapping[str, float | None]
"""Key of a figure -> its value from 0 to 1; None = undefined."""


@dataclass(frozen=True)
class Cell:
    """One method under one setting on one pair."""

    method: str
    setting: str
    benchmark: str
    pair: str
    group: str
    done: bool
    reason: str | None
    """Why it failed."""
    seconds: float
    stage_seconds: Mapping[str, float]
    peak_memory_bytes: int | None
    output: Path | None
    """Folder of the answer (docs/output.md)."""


@dataclass(frozen=True)
class Score:
    """One method under one setting on a whole benchmark."""

    method: str
    setting: str
    benchmark: str
    metrics: Figures
    headings: Mapping[str, str]
    groups: Mapping[str, Figures]
    intervals: Mapping[str, tuple[float, float]]
    pairs: Mapping[str, Figures]


@dataclass(frozen=True)
class FinishedRun:
    """Everything that a run wrote, less the answers themselves."""

    folder: Path
    about: Mapping[str, Any]
    """``experiment.json``."""
    cells: tuple[Cell, ...]
    scores: tuple[Score, ...]

    @property
    def name(self) -> str:
        """What the experiment is called."""
        return str(self.about["name"])

    @property
    def methods(self) -> tuple[str, ...]:
        """In the order of the configuration."""
        return tuple(self.about["methods"])

    @property
    def settings(self) -> tuple[str, ...]:
        """In the order of the configuration; the first one is what the others differ from."""
        return tuple(self.about["settings"])

    @property
    def benchmarks(self) -> tuple[str, ...]:
        """Names, in the order of the configuration."""
        return tuple(self.about["benchmarks"])

    def kind(self, benchmark: str) -> str:
        """What sort of benchmark it is, as the configuration calls it."""
        return str(self._configured(benchmark).get("kind", ""))

    def mode(self, benchmark: str) -> str:
        """How it is judged: strict unless the configuration says otherwise."""
        spec = self._configured(benchmark)
        options = spec.get("options")
        named = options.get("mode") if isinstance(options, dict) else None
        return str(named or spec.get("mode") or "strict")

    def _configured(self, benchmark: str) -> Mapping[str, Any]:
        specs = self.about["config"].get("benchmarks", [])
        found = dict(zip(self.benchmarks, specs, strict=False)).get(benchmark, {})
        return found if isinstance(found, dict) else {}

    @cached_property
    def _scores(self) -> dict[tuple[str, str, str], Score]:
        return {(s.benchmark, s.setting, s.method): s for s in self.scores}

    @cached_property
    def _cells(self) -> dict[tuple[str, str, str, str], Cell]:
        return {(c.benchmark, c.setting, c.method, c.pair): c for c in self.cells}

    def score(self, benchmark: str, setting: str, method: str) -> Score | None:
        """None where the method was not run there."""
        return self._scores.get((benchmark, setting, method))

    def cell(self, benchmark: str, setting: str, method: str, pair: str) -> Cell | None:
        """None where the method was not run there."""
        return self._cells.get((benchmark, setting, method, pair))

    def pairs(self, benchmark: str) -> dict[str, str]:
        """Pair -> its group, in the order of the run."""
        return {c.pair: c.group for c in self.cells if c.benchmark == benchmark}

    def columns(self, benchmark: str) -> tuple[tuple[str, str], ...]:
        """(setting, method) of the answers that are shown side by side.

        All methods under the first setting; a single method instead under each setting.
        """
        tried = [(s, m) for s, m in self.variants(benchmark) if s == self.settings[0]]
        return tuple(tried) if len(tried) > 1 else self.variants(benchmark)[:5]

    def variants(self, benchmark: str) -> tuple[tuple[str, str], ...]:
        """Every (setting, method) that was scored, setting by setting."""
        return tuple(
            (s, m) for s in self.settings for m in self.methods if (benchmark, s, m) in self._scores
        )


def read_run(folder: Path) -> FinishedRun:
    """Read ``experiment.json``, ``cells.json`` and ``scores.json``.

    Raises
    ------
    InputError
        If one of them is missing, damaged or of another version.
    """
    where = folder / "experiment.json"
    about = records.mapping(records.read_json(where), str(where))
    if about.get("schema") != 1:
        raise InputError(f"{where}: 'schema' should be 1; the run is of another version.")
    for key in ("name", "config", "benchmarks", "methods", "settings"):
        records.entry(about, key, str(where))
    for key in ("benchmarks", "methods", "settings"):
        if not all(isinstance(name, str) for name in records.sequence(about[key], str(where))):
            raise InputError(f"{where}: '{key}' should be a list of names.")
    records.mapping(about["config"], f"{where}: 'config'")
    cells = tuple(_cell(item, spot, folder) for item, spot in _items(folder / "cells.json"))
    scores = tuple(_score(item, spot) for item, spot in _items(folder / "scores.json"))
    return FinishedRun(folder, about, cells, scores)


def _items(path: Path) -> Iterator[tuple[dict[str, Any], str]]:
    for number, item in enumerate(records.sequence(records.read_json(path), str(path))):
        where = f"{path}: entry {number}"
        yield records.mapping(item, where), where


def _cell(item: dict[str, Any], where: str, folder: Path) -> Cell:
    names = [
        records.text(records.entry(item, key, where), f"{where}: '{key}'")
        for key in ("method", "setting", "benchmark", "pair")
    ]
    reason, memory, output = item.get("reason"), item.get("peak_memory_bytes"), item.get("output")
    stages = records.mapping(item.get("stage_seconds") or {}, f"{where}: 'stage_seconds'")
    return Cell(
        names[0], names[1], names[2], names[3],
        group=records.text(item.get("group") or "", f"{where}: 'group'"),
        done=records.entry(item, "status", where) == "done",
        reason=None if reason is None else records.text(reason, f"{where}: 'reason'"),
        seconds=records.number(item.get("seconds") or 0.0, f"{where}: 'seconds'"),
        stage_seconds={str(k): records.number(v, where) for k, v in stages.items()},
        peak_memory_bytes=None if memory is None else int(records.number(memory, where)),
        output=None if output is None else folder / _inside(str(output), where),
    )  # fmt: skip


def _inside(path: str, where: str) -> Path:
    """Links of the page lead into the run, nowhere else."""
    if Path(path).is_absolute() or ".." in Path(path).parts:
        raise InputError(f"{where}: 'output' should be a folder inside the run, not {path!r}.")
    return Path(path)


def _score(item: dict[str, Any], where: str) -> Score:
    names = [
        records.text(records.entry(item, key, where), f"{where}: '{key}'")
        for key in ("method", "setting", "benchmark")
    ]

    def table(key: str) -> dict[str, Any]:
        return records.mapping(records.entry(item, key, where), f"{where}: '{key}'")

    return Score(
        names[0], names[1], names[2],
        metrics=_figures(table("metrics"), where),
        headings={str(k): records.text(v, where) for k, v in table("headings").items()},
        groups={str(k): _figures(v, where) for k, v in table("groups").items()},
        intervals={str(k): _interval(v, where) for k, v in table("intervals").items()},
        pairs={str(k): _figures(v, where) for k, v in table("pairs").items()},
    )  # fmt: skip


def _figures(value: object, where: str) -> Figures:
    return {
        str(key): None if figure is None else records.number(figure, f"{where}: '{key}'")
        for key, figure in records.mapping(value, where).items()
    }


def _interval(value: object, where: str) -> tuple[float, float]:
    ends = [records.number(end, where) for end in records.sequence(value, where)]
    if len(ends) != 2:
        raise InputError(f"{where}: an interval should have two ends, not {len(ends)}.")
    return ends[0], ends[1]
