"""Rows of a table: variants of the method, run over rendered pairs and judged alike.

A row's answers lie in ``OUT/rows/<row>/<pair>/changes.json`` beside what they were made from, and
are made again only where that differs: a killed run continues.
"""

import json
import re
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from rich.console import Console

from data_tools.benchmarks.stages import PairStages, Stages, digest
from scenediff_classic.errors import InputError, SceneDiffError
from scenediff_classic.evaluation.benchmark import evaluate
from scenediff_classic.evaluation.metrics import Metrics
from scenediff_classic.pipeline import DetectConfig, decided
from scenediff_classic.result.run import json_ready
from scenediff_classic.result.writing import write_result
from scenediff_classic.types import Capture, ChangeResult
from scenediff_classic.workspace import write_atomic


class Rule(Protocol):
    """From stages to the answer: the quick half of the method, or what takes its place."""

    def __call__(
        self, before: Capture, after: Capture, stages: Stages, config: DetectConfig
    ) -> ChangeResult:
        """Decide."""
        ...


@dataclass(frozen=True)
class AsEver:
    """The method's own rule."""

    def __call__(
        self, before: Capture, after: Capture, stages: Stages, config: DetectConfig
    ) -> ChangeResult:
        """See `pipeline.decided`."""
        return decided(before, after, stages.geometry, stages.regions, stages.scores, config)


@dataclass(frozen=True)
class Row:
    """A variant of the method."""

    group: str
    name: str
    config: Callable[[Path], DetectConfig]
    """The options for a pair; what they share between pairs makes no difference."""
    rule: Callable[[Path], Rule] = field(default=lambda pair: AsEver())
    workspace: str = "patchmatch"
    """Where geometry is found: see `stages.PairStages`."""
    variant: str = ""
    """Tells rows of one name apart, of which only the best is shown."""

    @property
    def folder(self) -> str:
        """Name of a folder for its answers."""
        words = f"{self.group} {self.name} {self.variant}"
        return re.sub(r"[^a-z0-9.]+", "-", words.lower()).strip("-") + "-" + digest(words)[:4]


@dataclass(frozen=True)
class Judged:
    """A row with its figures over all pairs; a pair that failed counts as all missed."""

    row: Row
    metrics: Metrics
    failures: Mapping[str, str]
    """Pair -> why it has no answer."""


def rendered_pairs(root: Path) -> list[Path]:
    """Folders of the rendered pairs below `root`.

    Raises
    ------
    InputError
        If there are none.
    """
    folders = sorted(p.parent for p in root.glob("*/segments.json"))
    if not folders:
        raise InputError(f"{root} holds no rendered pairs: make some first.")
    return folders


def judged_rows(
    rows: Sequence[Row],
    root: Path,
    out: Path,
    work: Path,
    console: Console,
) -> list[Judged]:
    """Run every row on every pair below `root`, and judge it in strict mode.

    Parameters
    ----------
    out : Path
        Answers are written below ``rows`` there.
    work : Path
        Stages are kept there, by pair; several commands may share it, one after the other.
    """
    failures: dict[str, dict[str, str]] = {row.folder: {} for row in rows}
    for pair in rendered_pairs(root):
        stages = PairStages(pair, work / pair.name)
        for row in rows:
            try:
                if _answer(row, stages, out / "rows" / row.folder / pair.name):
                    console.print(f"{pair.name}: {row.group}, {row.name} {row.variant}".rstrip())
            except Exception as error:  # whatever it is, the other pairs and rows still count
                known = isinstance(error, SceneDiffError)
                why = str(error) if known else f"{type(error).__name__}: {error}"
                failures[row.folder][pair.name] = why
                console.print(f"{pair.name}: {row.group}, {row.name}: failed: {why}")
                if not known:
                    console.print("".join(traceback.format_exception(error)), markup=False)
    return [
        Judged(row, evaluate(_made(out / "rows" / row.folder), root).metrics, failures[row.folder])
        for row in rows
    ]


def _answer(row: Row, stages: PairStages, folder: Path) -> bool:
    """Write the answer of a row for a pair; False if it was there."""
    config, rule = row.config(stages.pair), row.rule(stages.pair)
    key = digest(stages.identity, json_ready(config), json_ready(rule))
    answer, origin = folder / "changes.json", folder / "made_from.json"
    if answer.is_file() and origin.is_file() and json.loads(origin.read_text())["key"] == key:
        return False
    answer.unlink(missing_ok=True)
    result = rule(*stages.captures, stages(config, row.workspace), config)
    content = {"key": key, "config": json_ready(config), "rule": json_ready(rule)}
    write_atomic(origin, json.dumps(content, indent=1) + "\n")
    write_result(result, answer)
    return True


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def best_variants(judged: Sequence[Judged]) -> list[Judged]:
    """Of the rows of one group and name, the (first) one with the highest obj/im AP."""
    best: dict[tuple[str, str], Judged] = {}
    for item in judged:
        key = item.row.group, item.row.name
        if key not in best or _rank(item) > _rank(best[key]):
            best[key] = item
    return list(best.values())


def _rank(item: Judged) -> float:
    return item.metrics.obj_im_ap or 0.0


def with_option(config: Any, path: str, value: Any) -> Any:
    """Nested frozen dataclasses with one field replaced, such as ``scoring.voxel``."""
    name, _, rest = path.partition(".")
    return replace(
        config, **{name: with_option(getattr(config, name), rest, value) if rest else value}
    )
