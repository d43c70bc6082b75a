"""Judged rows as pictures: what each row is worth, and how a figure follows an option."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from data_tools.benchmarks.row_tables import METRICS, numbers
from data_tools.benchmarks.rows import Judged
from scenediff_classic.workspace import write_atomic

_INK, _GREY, _BETTER, _WORSE = "#222222", "#9a9a9a", "#1b7f5c", "#c2452d"
_LINES = {
    "px_im_iou": "#3b6fb6",
    "obj_im_ap": "#c2452d",
    "obj_sc_ap": "#1b7f5c",
    "obj_sc_ap_typed": "#8c6bb1",
}


def draw_rows(judged: Sequence[Judged], path: Path) -> None:
    """A panel for each figure: how far every row lies from the first one, which is the default."""
    base = numbers(judged[0].metrics)
    height = 0.24 * len(judged) + 0.2 * len({j.row.group for j in judged}) + 1.1
    figure = Figure(figsize=(11, height), layout="constrained")
    panels = figure.subplots(1, len(METRICS), sharey=True)
    places = _places(judged)
    for axes, (metric, title) in zip(panels, METRICS.items(), strict=True):
        axes.set_title(title, loc="left", fontsize=11, color=_INK)
        start = 100 * (base[metric] or 0)
        axes.axvline(start, color=_GREY, lw=0.8, ls=(0, (3, 3)), zorder=0)
        for place, item in zip(places, judged, strict=True):
            value = 100 * (numbers(item.metrics)[metric] or 0)
            colour = _INK if item is judged[0] else _BETTER if value >= start else _WORSE
            axes.plot([start, value], [place, place], color=colour, lw=1.6, alpha=0.45)
            axes.plot(value, place, "o", color=colour, ms=5)
            right = value >= start
            axes.annotate(
                f"{value:.1f}", (value, place), (5 if right else -5, 0), fontsize=7.5,
                textcoords="offset points", color=colour, va="center",
                ha="left" if right else "right",
            )  # fmt: skip
        axes.set_xlim(-12, 114)
        axes.set_xticks([0, 25, 50, 75, 100])
        _quiet(axes)
    labels = [f"{j.row.name} {j.row.variant}".rstrip() for j in judged]
    panels[0].set_yticks(places, labels, fontsize=8.5)
    panels[0].set_ylim(max(places) + 0.8, min(places) - 1.2)
    seen: set[str] = set()
    for place, item in zip(places, judged, strict=True):
        if item.row.group not in seen:
            panels[0].text(
                -0.03, place - 0.78, item.row.group, transform=panels[0].get_yaxis_transform(),
                ha="right", va="center", fontsize=8.5, fontweight="bold", color=_INK,
            )  # fmt: skip
        seen.add(item.row.group)
    _save(figure, path)


def _places(judged: Sequence[Judged]) -> list[float]:
    """Heights of the rows, with room for a heading above each group."""
    places, place, last = [], 0.0, None
    for item in judged:
        place += 1.0 if item.row.group == last else 1.9
        places.append(place)
        last = item.row.group
    return places


def draw_curves(
    curves: Mapping[str, Sequence[Judged]],
    defaults: Mapping[str, float | None],
    base: Judged,
    path: Path,
) -> None:
    """A panel for each option: the figures over its values.

    Parameters
    ----------
    curves : mapping
        Title -> rows of which each `name` is a number, in their order.
    defaults : mapping
        Title -> value that stands for `base`; None = `base` has no fixed value, and is drawn as
        level lines.
    base : Judged
        The method as it is.
    """
    columns = min(4, len(curves))
    lines = -(-len(curves) // columns)
    figure = Figure(figsize=(3.1 * columns, 2.5 * lines + 0.5), layout="constrained")
    grid = figure.subplots(lines, columns, sharey=True, squeeze=False)
    for axes in grid.flat[len(curves) :]:
        axes.set_visible(False)
    for axes, (title, rows) in zip(grid.flat, curves.items(), strict=False):
        _curve(axes, title, rows, defaults[title], base)
    handles, names = grid.flat[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=len(names), frameon=False)
    _save(figure, path)


def _curve(
    axes: Axes, title: str, rows: Sequence[Judged], default: float | None, base: Judged
) -> None:
    axes.set_title(title, loc="left", fontsize=9.5, color=_INK)
    points = [(float(r.row.name), r) for r in rows]
    if default is not None:
        points = sorted([*(p for p in points if p[0] != default), (default, base)], key=_first)
        axes.axvline(default, color=_GREY, lw=0.8, ls=(0, (3, 3)), zorder=0)
    for metric, name in METRICS.items():
        values = [100 * (numbers(r.metrics)[metric] or 0) for _, r in points]
        axes.plot([x for x, _ in points], values, "o-", color=_LINES[metric], ms=3, lw=1.4,
                  label=name)  # fmt: skip
        level = 100 * (numbers(base.metrics)[metric] or 0)
        if default is None:
            axes.axhline(level, color=_LINES[metric], lw=0.8, ls=(0, (3, 3)), zorder=0)
        else:
            axes.plot(default, level, "*", color=_LINES[metric], ms=9)
    axes.set_ylim(0, 100)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    _quiet(axes)


def _first(point: tuple[float, Judged]) -> float:
    return point[0]


def _quiet(axes: Axes) -> None:
    """Little ink beside the data."""
    axes.grid(axis="both", color="#ececec", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(length=0, labelsize=8, colors=_INK)


def _save(figure: Figure, path: Path) -> None:
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=90, pil_kwargs={"optimize": True})
    write_atomic(path, stream.getvalue())
