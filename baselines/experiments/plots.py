"""Figures with axes: what methods are worth, how a setting matters, where cameras went."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO

import numpy as np
from jaxtyping import Float64
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from baselines.experiments.finished import FinishedRun
from scenediff_classic.report.palette import KIND_COLOUR, VIDEO_COLOUR, css
from scenediff_classic.types import VIDEOS, Kind, Video

_INK, _GREY, _PALE = "#222222", "#9a9a9a", "#ececec"
LINES = ("#3b6fb6", "#c2452d", "#1b7f5c", "#8c6bb1", "#b8860b", "#4d4d4d", "#d1689c", "#2a9d9d")


@dataclass(frozen=True)
class Place:
    """A changed object seen from above."""

    label: str
    kind: Kind
    at: Mapping[Video, Float64[np.ndarray, "2"]]
    """Where it was and is, in the plane of the plot."""


def metric_plot(run: FinishedRun, benchmark: str, titles: Sequence[str]) -> Figure:
    """A panel for each figure: every method's value, and its interval as a line."""
    columns = run.columns(benchmark)
    scores = [run.score(benchmark, s, m) for s, m in columns]
    names: dict[str, str] = {}
    for score in scores:
        names.update(score.headings if score else {})
    figure = Figure(
        figsize=(2.1 + 2.1 * len(names), 0.34 * len(titles) + 0.8), layout="constrained"
    )
    panels = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    for axes, (key, name) in zip(panels, names.items(), strict=True):
        axes.set_title(name, loc="left", fontsize=10, color=_INK)
        for place, score in enumerate(scores):
            value = score.metrics.get(key) if score else None
            if score is None or value is None:
                continue
            colour = LINES[place % len(LINES)]
            low, high = score.intervals.get(key, (value, value))
            axes.plot([100 * low, 100 * high], [place, place], color=colour, lw=2.4, alpha=0.4)
            axes.plot(100 * value, place, "o", color=colour, ms=6)
        axes.set_xlim(-3, 103)
        axes.set_xticks([0, 25, 50, 75, 100])
        _quiet(axes)
    panels[0].set_yticks(range(len(titles)), titles, fontsize=9)
    panels[0].set_ylim(len(titles) - 0.5, -0.5)
    return figure


def sensitivity_plot(
    run: FinishedRun, benchmark: str, method: str, option: str, points: Mapping[str, float]
) -> Figure:
    """The figures over a number, which is all that tells some settings apart.

    Parameters
    ----------
    points : mapping
        Setting -> its number.
    """
    figure = Figure(figsize=(5.2, 3.2), layout="constrained")
    axes = figure.subplots()
    ranked = sorted(points.items(), key=lambda item: item[1])
    scores = [(x, s) for name, x in ranked if (s := run.score(benchmark, name, method)) is not None]
    keys = scores[0][1].headings
    for i, (key, name) in enumerate(keys.items()):
        known = [(x, v, s) for x, s in scores if (v := s.metrics.get(key)) is not None]
        xs, colour = [x for x, _, _ in known], LINES[i % len(LINES)]
        axes.plot(xs, [100 * v for _, v, _ in known], "o-", color=colour, ms=4, lw=1.5, label=name)
        ends = [s.intervals.get(key, (v, v)) for _, v, s in known]
        low, high = [100 * e[0] for e in ends], [100 * e[1] for e in ends]
        axes.fill_between(xs, low, high, color=colour, alpha=0.1, lw=0)
    axes.set_ylim(0, 100)
    axes.set_xlabel(option, fontsize=9)
    axes.set_ylabel("percent", fontsize=9)
    figure.legend(loc="outside lower center", ncols=min(len(keys), 4), frameon=False, fontsize=8)
    _quiet(axes)
    return figure


def trajectory_plot(
    centres: Mapping[Video, Float64[np.ndarray, "n 2"]],
    looks: Mapping[Video, Float64[np.ndarray, "n 2"]],
    points: Float64[np.ndarray, "m 2"],
    places: Sequence[Place],
) -> Figure:
    """Camera centres of both captures from above, with the changed objects' places.

    Parameters
    ----------
    looks : mapping
        Which way every camera looks, as seen from above.
    points : array
        Measured points, drawn as a pale plan of the place.
    """
    figure = Figure(figsize=(4.6, 3.9), layout="constrained")
    axes = figure.subplots()
    everything = np.concatenate(
        [*centres.values(), *(np.array(list(p.at.values())) for p in places)]
    )
    low, high = _bounds(points, everything)
    if len(points):
        counts, xs, ys = np.histogram2d(
            points[:, 0], points[:, 1], bins=110, range=[[low[0], high[0]], [low[1], high[1]]]
        )
        axes.imshow(
            np.sqrt(counts.T), origin="lower", extent=(xs[0], xs[-1], ys[0], ys[-1]), cmap="Greys",
            vmax=2.2 * float(np.sqrt(counts).max(initial=1)), interpolation="nearest",
        )  # fmt: skip
    step = 0.06 * float(np.max(high - low))
    for video in VIDEOS:
        xy, colour = centres[video], css(VIDEO_COLOUR[video])
        axes.plot(*xy.T, "o-", color=colour, ms=3.5, lw=1.2, label=f"cameras {video}")
        for at, look in zip(xy, looks[video], strict=True):
            axes.plot(*np.stack([at, at + step * look]).T, color=colour, lw=0.8, alpha=0.7)
    for place in places:
        _place(axes, place)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal")
    _quiet(axes)
    axes.grid(visible=False)
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=8)
    return figure


def _bounds(points: np.ndarray, most: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All cameras and objects, and the room around them less its wildest points."""
    ends = [most.min(axis=0), most.max(axis=0)]
    if len(points):
        ends += [np.percentile(points, 2, axis=0), np.percentile(points, 98, axis=0)]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    pad = 0.06 * float(np.max(high - low)) + 1e-6
    return low - pad, high + pad


def _place(axes: Axes, place: Place) -> None:
    colour = css(KIND_COLOUR[place.kind])
    at = [(float(x), float(y)) for x, y in place.at.values()]
    if len(at) == 2:
        axes.annotate("", at[1], at[0], arrowprops={"arrowstyle": "->", "color": colour, "lw": 1.4})
    axes.plot(*at[-1], "s", color=colour, ms=7, mec=_INK, mew=0.6)
    axes.annotate(place.label, at[-1], (6, 5), textcoords="offset points", fontsize=8, color=_INK)


def _quiet(axes: Axes) -> None:
    """Little ink beside the data."""
    axes.grid(axis="both", color=_PALE, lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(length=0, labelsize=8, colors=_INK)


def drawn_as(figure: Figure, form: str) -> bytes:
    """The figure as a file, the same bytes every time: ``svg`` for the page, ``pdf`` for papers."""
    stream = BytesIO()
    undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}[form]
    with rc_context({"svg.hashsalt": "scenediff", "svg.fonttype": "path", "pdf.fonttype": 42}):
        figure.savefig(stream, format=form, metadata=undated, dpi=150)
    return stream.getvalue()
