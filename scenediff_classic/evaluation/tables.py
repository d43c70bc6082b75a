"""An evaluation as tables for a person and as JSON for a program."""

import json
from dataclasses import asdict
from typing import Any

from rich.table import Table

from scenediff_classic.evaluation.benchmark import EvaluationResult
from scenediff_classic.evaluation.metrics import Metrics

HEADINGS = {
    "px_im_iou": "px/im IoU",
    "obj_im_ap": "obj/im AP",
    "obj_sc_ap": "obj/sc AP",
    "obj_sc_ap_typed": "obj/sc AP, typed",
}
"""Metric -> what the paper calls it; tables give them in percent."""


def summary_table(result: EvaluationResult) -> Table:
    """One row: all pairs that count, pooled. The title names the mode."""
    counted = sum(row.metrics is not None for row in result.pairs)
    title = f"{counted} of {len(result.pairs)} pairs, {result.mode} mode, percent"
    table = _table(title)
    table.add_row(*_cells(result.metrics))
    return table


def pair_table(result: EvaluationResult) -> Table:
    """One row a pair, with what is wrong where a pair has no usable prediction."""
    table = _table(f"Pair by pair, {result.mode} mode, percent", "pair")
    troubled = any(row.problem for row in result.pairs)
    if troubled:
        table.add_column("problem", overflow="fold")
    for row in result.pairs:
        cells = _cells(row.metrics)
        table.add_row(row.pair, *cells, *([row.problem or ""] if troubled else []))
    return table


def to_json(result: EvaluationResult) -> str:
    """The result as a JSON text: metrics from 0 to 1, null where undefined.

    ``{"schema": 1, "mode", "metrics": {...}, "pairs": [{"pair", "problem", "metrics"}],
    "warnings"}``; ``metrics`` of a pair that does not count is null.
    """
    content: dict[str, Any] = {
        "schema": 1,
        "mode": result.mode,
        "metrics": asdict(result.metrics),
        "pairs": [
            {
                "pair": row.pair,
                "problem": row.problem,
                "metrics": None if row.metrics is None else asdict(row.metrics),
            }
            for row in result.pairs
        ],
        "warnings": list(result.warnings),
    }
    return json.dumps(content, ensure_ascii=False, allow_nan=False, indent=2)


def _table(title: str, *first: str) -> Table:
    table = Table(title=title)
    for heading in first:
        table.add_column(heading, overflow="fold")
    for heading in (*HEADINGS.values(), "found / true", "reported"):
        table.add_column(heading, justify="right")
    return table


def _cells(metrics: Metrics | None) -> list[str]:
    if metrics is None:
        return ["-"] * (len(HEADINGS) + 2)
    values = (getattr(metrics, name) for name in HEADINGS)
    percents = ["-" if value is None else f"{100 * value:.1f}" for value in values]
    found = f"{metrics.found_objects} / {metrics.true_objects}"
    return [*percents, found, str(metrics.reported_objects)]
