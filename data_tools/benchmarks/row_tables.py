"""Judged rows as tables: for the terminal, as CSV, JSON and Markdown."""

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from data_tools.benchmarks.rows import Judged
from scenediff_classic.evaluation.metrics import Metrics
from scenediff_classic.workspace import write_atomic

METRICS = {
    "px_im_iou": "px/im IoU",
    "obj_im_ap": "obj/im AP",
    "obj_sc_ap": "obj/sc AP",
    "obj_sc_ap_typed": "type-aware",
}
"""The figures of the benchmark that are compared; tables give them in percent."""

_COUNTS = ("found", "true", "others", "failed pairs")


def numbers(metrics: Metrics) -> dict[str, float | None]:
    """The compared figures, from 0 to 1."""
    return {name: getattr(metrics, name) for name in METRICS}


def percent(value: float | None) -> str:
    """A figure as tables show it."""
    return "-" if value is None else f"{100 * value:.1f}"


def metrics_table(title: str, *first: str) -> Table:
    """An empty table with a column for each compared figure after the `first` ones."""
    table = Table(title=title)
    for name in first:
        table.add_column(name, no_wrap=True)
    for name in METRICS.values():
        table.add_column(_two_lines(name), justify="right", min_width=5)
    return table


def rows_table(title: str, judged: Sequence[Judged]) -> Table:
    """One line a row, with a rule between groups."""
    table = metrics_table(title, "row")
    for name in _COUNTS:
        table.add_column(_two_lines(name), justify="right", min_width=4)
    last = None
    for item in judged:
        if last not in (None, item.row.group):
            table.add_section()
        if item.row.group != last:
            table.add_row(f"[bold]{item.row.group}[/bold]")
        table.add_row(*_cells(item))
        last = item.row.group
    return table


def write_rows(judged: Sequence[Judged], stem: Path, **about: Any) -> None:
    """Write ``<stem>.csv``, ``.json`` and ``.md``.

    Parameters
    ----------
    about
        What else the JSON shall say, as plain values.
    """
    records = [_record(item) for item in judged]
    text = io.StringIO()
    plain = [{k: v for k, v in r.items() if k != "failures"} for r in records]
    writer = csv.DictWriter(text, list(plain[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(plain)
    write_atomic(stem.with_suffix(".csv"), text.getvalue())
    content = {**about, "rows": records}
    write_atomic(stem.with_suffix(".json"), json.dumps(content, indent=1) + "\n")
    heading = ("", "row", *METRICS.values(), *_COUNTS)
    lines = [heading, ("---",) * 2 + ("--:",) * (len(heading) - 2)]
    lines += [(item.row.group, *_cells(item)) for item in judged]
    markdown = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    write_atomic(stem.with_suffix(".md"), markdown)


def _two_lines(heading: str) -> str:
    """Narrow, so that a table fits on a terminal."""
    return heading.replace(" ", "\n").replace("-", "-\n")


def _cells(item: Judged) -> list[str]:
    m = item.metrics
    counts = (m.found_objects, m.true_objects, _others(m), len(item.failures))
    name = f"{item.row.name} {item.row.variant}".rstrip()
    return [name, *(percent(v) for v in numbers(m).values()), *(str(c) for c in counts)]


def _record(item: Judged) -> dict[str, Any]:
    m = item.metrics
    return {
        "group": item.row.group,
        "row": item.row.name,
        "variant": item.row.variant,
        **numbers(m),
        "found": m.found_objects,
        "true": m.true_objects,
        "others": _others(m),
        "failed_pairs": len(item.failures),
        "failures": dict(item.failures),
    }


def _others(metrics: Metrics) -> int:
    return metrics.reported_objects - metrics.found_objects
