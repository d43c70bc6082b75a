"""One value for a table, and how it looks on a terminal, as CSV, in LaTeX and in HTML."""

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape as html_escape
from pathlib import Path

from rich import box
from rich.markup import escape as rich_escape
from rich.table import Table as RichTable

from scenediff_classic.workspace import write_atomic

NOTHING = "\N{EN DASH}"
"""Where there is no figure."""

_TEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "%": r"\%", "_": r"\_", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "\N{EN DASH}": "--",
    "\N{MINUS SIGN}": "$-$", "\N{MULTIPLICATION SIGN}": r"$\times$", "\n": " ",
}  # fmt: skip


@dataclass(frozen=True)
class Value:
    """What stands in one place of a table."""

    text: str
    interval: tuple[str, str] | None = None
    """Its ends, as texts."""
    best: bool = False
    """Nothing above or below it is better."""

    @property
    def between(self) -> str:
        """The interval as one text."""
        return "" if self.interval is None else f"[{self.interval[0]}, {self.interval[1]}]"


@dataclass(frozen=True)
class Column:
    """A column and its heading."""

    heading: str
    number: bool = True
    """Numbers stand to the right, names to the left."""


@dataclass(frozen=True)
class Table:
    """A table, whatever it is shown on."""

    key: str
    """Stem of its files."""
    title: str
    about: str
    """What it holds for: benchmark, mode, number of pairs, unit."""
    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"{self.key}: {len(row)} values for {len(self.columns)} columns.")


def number(value: float | None, places: int = 1, scale: float = 1.0) -> str:
    """A figure as tables show it."""
    return NOTHING if value is None else f"{scale * value:.{places}f}"


def percent(
    value: float | None, interval: tuple[float, float] | None = None, *, best: bool = False
) -> Value:
    """A figure from 0 to 1 in percent."""
    ends = None if interval is None else (number(interval[0], 1, 100), number(interval[1], 1, 100))
    return Value(number(value, 1, 100), ends, best)


def texts(*values: object) -> tuple[Value, ...]:
    """Plain values."""
    return tuple(Value(str(value)) for value in values)


def to_rich(table: Table) -> RichTable:
    """For the terminal; intervals stand below their figures."""
    out = RichTable(
        title=rich_escape(table.title), caption=rich_escape("\n".join((table.about, *table.notes))),
        box=box.SIMPLE_HEAD, padding=(0, 1), pad_edge=False,
    )  # fmt: skip
    for column in table.columns:
        heading = column.heading.replace(" ", "\n", 1) if column.number else column.heading
        out.add_column(rich_escape(heading), justify="right" if column.number else "left")
    for row in table.rows:
        out.add_row(*(_rich(value) for value in row))
    return out


def _rich(value: Value) -> str:
    text = rich_escape(value.text)
    text = f"[bold]{text}[/bold]" if value.best else text
    return f"{text}\n[dim]{rich_escape(value.between)}[/dim]" if value.interval else text


def to_csv(table: Table) -> str:
    """Plain figures; an interval has two columns of its own."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    wide = [any(row[i].interval for row in table.rows) for i in range(len(table.columns))]
    writer.writerow(
        [
            name
            for column, both in zip(table.columns, wide, strict=True)
            for name in _heads(column.heading, both)
        ]
    )
    for row in table.rows:
        cells: list[str] = []
        for value, both in zip(row, wide, strict=True):
            text = "" if value.text == NOTHING else value.text
            cells += [text, *(value.interval or ("", ""))] if both else [text]
        writer.writerow(cells)
    return stream.getvalue()


def _heads(heading: str, both: bool) -> list[str]:
    return [heading, f"{heading} low", f"{heading} high"] if both else [heading]


def to_latex(table: Table) -> str:
    """A ``table`` that needs the package ``booktabs``."""
    kinds = "".join("r" if column.number else "l" for column in table.columns)
    caption = _sentences((table.title, table.about, *table.notes))
    lines = [
        r"\begin{table}", r"\centering", rf"\caption{{{tex(caption)}}}",
        rf"\label{{tab:{stem(table.key)}}}",
        rf"\begin{{tabular}}{{{kinds}}}", r"\toprule",
        " & ".join(tex(column.heading) for column in table.columns) + r" \\", r"\midrule",
        *(" & ".join(_latex(value) for value in row) + r" \\" for row in table.rows),
        r"\bottomrule", r"\end{tabular}", r"\end{table}",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _latex(value: Value) -> str:
    text = rf"\textbf{{{tex(value.text)}}}" if value.best else tex(value.text)
    return rf"{text} {{\scriptsize {tex(value.between)}}}" if value.interval else text


def tex(text: str) -> str:
    """Text that LaTeX prints as it is."""
    return "".join(_TEX.get(letter, letter) for letter in text)


def _sentences(parts: Sequence[str]) -> str:
    return " ".join(part if part.endswith(".") else f"{part}." for part in parts if part)


def to_html(table: Table) -> str:
    """A figure with a caption, its rows named by their first value; the style is the page's."""
    head = "".join(
        f'<th scope="col"{_side(column)}>{html_escape(column.heading)}</th>'
        for column in table.columns
    )
    body = "".join(
        "<tr>"
        + "".join(
            _html(value, column, first=i == 0)
            for i, (value, column) in enumerate(zip(row, table.columns, strict=True))
        )
        + "</tr>\n"
        for row in table.rows
    )
    notes = "".join(f'<p class="note">{html_escape(note)}</p>' for note in table.notes)
    title, about = html_escape(table.title), html_escape(table.about)
    return (
        f'<figure class="table" id="table-{stem(table.key)}">\n'
        f'<figcaption><b>{title}</b> <span class="about">{about}</span></figcaption>\n'
        f'<div class="scroll" role="region" aria-label="{title}" tabindex="0">\n'
        f"<table><thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody></table></div>\n"
        f"{notes}</figure>\n"
    )


def _side(column: Column) -> str:
    return ' class="number"' if column.number else ""


def _html(value: Value, column: Column, *, first: bool) -> str:
    text = html_escape(value.text)
    text = f"<strong>{text}</strong>" if value.best else text
    if value.interval:
        text += f' <small class="interval">{html_escape(value.between)}</small>'
    tag, scope = ("th", ' scope="row"') if first else ("td", "")
    return f"<{tag}{scope}{_side(column)}>{text}</{tag}>"


def stem(name: str) -> str:
    """A name as files, labels and anchors can carry it."""
    return re.sub(r"[^A-Za-z0-9.]+", "-", name).strip("-.") or "unnamed"


def write_table(table: Table, folder: Path) -> list[Path]:
    """Write ``<key>.csv``, ``.tex`` and ``.html`` (a piece for other pages).

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    made = {".csv": to_csv(table), ".tex": to_latex(table), ".html": to_html(table)}
    paths = []
    for suffix, content in made.items():
        paths.append(folder / f"{stem(table.key)}{suffix}")
        write_atomic(paths[-1], content)
    return paths
