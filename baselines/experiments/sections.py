"""What the page shows of one benchmark, gathered pair by pair so that pictures do not pile up."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from baselines.experiments.comparisons import (
    ablation_table,
    column_titles,
    group_table,
    headings,
    main_table,
    pair_table,
)
from baselines.experiments.contents import kind_table, statistics_table
from baselines.experiments.costs import runtime_table, stage_table
from baselines.experiments.finished import FinishedRun
from baselines.experiments.gallery import Exhibit, exhibit, worst_answers
from baselines.experiments.pair_pictures import PairPictures, read_pair
from baselines.experiments.pair_sections import PairSection, pair_section, report_link, write_grid
from baselines.experiments.plots import drawn_as, metric_plot, sensitivity_plot
from baselines.experiments.published import published_tables
from baselines.experiments.tables import Table, stem
from data_tools.benchmarks.benchmark import BenchmarkPair
from scenediff_classic.errors import SceneDiffError
from scenediff_classic.workspace import write_atomic

WORST = 9
"""Entries of the failure gallery."""
PICTURED = 24
"""Pairs with pictures on the page, to keep it light; the folder of figures has them all."""


@dataclass(frozen=True)
class Plot:
    """A figure with axes, and where its files are."""

    title: str
    svg: str
    pdf: str
    """From the page."""
    caption: str
    wide: bool = False


@dataclass(frozen=True)
class BenchmarkSection:
    """All of one benchmark."""

    name: str
    anchor: str
    main: Table
    kinds: Table | None
    groups: tuple[Table, ...]
    by_pair: tuple[Table, ...]
    ablations: tuple[Table, ...]
    runtime: Table
    stages: Table | None
    statistics: Table | None
    published: tuple[Table, ...]
    metrics: Plot
    curves: tuple[Plot, ...]
    pairs: tuple[PairSection, ...]
    plans: tuple[Plot | None, ...]
    """By pair."""
    gallery: tuple[Exhibit, ...]
    gallery_by: str

    @property
    def tables(self) -> tuple[Table, ...]:
        """Every table of it."""
        single = (self.main, self.kinds, self.runtime, self.stages, self.statistics)
        return (
            *(t for t in single if t is not None), *self.groups, *self.by_pair, *self.ablations,
            *self.published,
        )  # fmt: skip


def benchmark_section(
    run: FinishedRun, benchmark: str, pairs: Sequence[BenchmarkPair], metric: str | None,
    wrote: Callable[[Path], None],
) -> BenchmarkSection:  # fmt: skip
    """Gather it, and write its figures.

    Parameters
    ----------
    pairs
        As the benchmark gives them; those that the run does not have are left out.
    metric : str, optional
        The figure by which the failure gallery is sorted; the benchmark's first one if left out.
    wrote : callable
        Told of every file.
    """
    names = headings(run, benchmark)
    key = metric if metric in names else next(iter(names), "")
    folder = run.folder / "figures" / stem(benchmark)
    titles = column_titles(run, benchmark)
    worst = worst_answers(run, benchmark, key, WORST)
    sections, plans, exhibits, light = [], [], {}, []
    known = {pair.name: pair for pair in pairs}
    for number, (name, group) in enumerate(run.pairs(benchmark).items()):
        anchor = f"pair-{stem(benchmark)}-{stem(name)}"
        try:
            if name not in known:
                raise SceneDiffError(f"The benchmark no longer has the pair {name}.")
            pictures = read_pair(run, benchmark, known[name], titles)
            section = pair_section(run, pictures, anchor)
        except SceneDiffError as error:
            sections.append(_without_pictures(anchor, name, group, str(error)))
            plans.append(None)
            continue
        wrote(write_grid(pictures, folder / stem(name) / "grid.jpg"))
        plans.append(_plan(run, section, folder / stem(name) / "trajectory", wrote))
        exhibits |= _exhibits(run, pictures, worst, names[key])
        light.append(pictures.emptied())
        if number < PICTURED:
            sections.append(section)
    methods = list(dict.fromkeys(m for _, m in run.variants(benchmark)))
    tables = (ablation_table(run, benchmark, method) for method in methods)
    ablations = tuple(table for table in tables if table is not None)
    chart = metric_plot(run, benchmark, titles)
    return BenchmarkSection(
        benchmark, stem(benchmark), main_table(run, benchmark),
        kind_table(run, benchmark, light) if light else None,
        tuple(t for k in names if (t := group_table(run, benchmark, k)) is not None),
        tuple(pair_table(run, benchmark, k) for k in names),
        ablations,
        runtime_table(run, benchmark), stage_table(run, benchmark),
        statistics_table(run, benchmark, light) if light else None,
        published_tables(run.kind(benchmark), ablation=bool(ablations)),
        _plot(run, chart, folder / "metrics", "Figures with intervals",
              "Dots: all pairs pooled. Bars: 95 % intervals over pairs.", wrote, wide=True),
        tuple(_curves(run, benchmark, methods, folder, wrote)),
        tuple(sections), tuple(plans), tuple(exhibits[i] for i in sorted(exhibits)),
        names.get(key, key),
    )  # fmt: skip


def _exhibits(run: FinishedRun, pictures: PairPictures, worst: Sequence, heading: str) -> dict:
    found: dict[int, Exhibit] = {}
    for rank, item in enumerate(worst, start=1):
        if item.pair == pictures.name:
            setting, method = run.columns(pictures.benchmark)[item.column]
            answer = next(
                a for a in pictures.answers if (a.cell.setting, a.cell.method) == (setting, method)
            )
            report = report_link(run, answer)
            found[rank] = exhibit(run, pictures, item, rank, heading, report)
    return found


def _without_pictures(anchor: str, name: str, group: str, why: str) -> PairSection:
    return PairSection(anchor, name, group, (), (), (), (), "", None, None, "", why)


def _plan(
    run: FinishedRun, section: PairSection, path: Path, wrote: Callable[[Path], None]
) -> Plot | None:
    if section.plan is None:
        return None
    what = f"Cameras and changed objects of {section.name} from above"
    caption = (
        f"Seen from above, as {section.plan_of} has them: cameras of both captures and the way "
        "they look, reported objects (arrow: from where to where), measured points in grey."
    )
    return _plot(run, section.plan, path, what, caption, wrote)


def _curves(
    run: FinishedRun, benchmark: str, methods: Sequence[str], folder: Path,
    wrote: Callable[[Path], None],
) -> list[Plot]:  # fmt: skip
    plots = []
    for option, points in swept(run.settings).items():
        for method in methods:
            known = {s: x for s, x in points.items() if run.score(benchmark, s, method) is not None}
            if len(known) < 2:
                continue
            figure = sensitivity_plot(run, benchmark, method, option, known)
            path = folder / f"sensitivity-{stem(method)}-{stem(option)}"
            caption = f"{method} over {option}; all else as in its first setting. Bands: intervals."
            plots.append(_plot(run, figure, path, f"{method}: {option}", caption, wrote))
    return plots


def swept(settings: Sequence[str]) -> dict[str, dict[str, float]]:
    """Option -> setting -> number, for settings whose names are ``<option>=<number>``."""
    found: dict[str, dict[str, float]] = {}
    for setting in settings:
        option, _, value = setting.rpartition("=")
        try:
            x = float(value)
        except ValueError:
            continue
        if option and abs(x) < float("inf"):
            found.setdefault(option, {})[setting] = x
    return found


def _plot(
    run: FinishedRun, figure: Figure, path: Path, title: str, caption: str,
    wrote: Callable[[Path], None], *, wide: bool = False,
) -> Plot:  # fmt: skip
    files = {form: path.with_name(f"{path.name}.{form}") for form in ("svg", "pdf")}
    made = {form: drawn_as(figure, form) for form in files}
    for form, file in files.items():
        write_atomic(file, made[form])
        wrote(file)
    relative = files["pdf"].relative_to(run.folder).as_posix()
    return Plot(title, made["svg"].decode(), relative, caption, wide)
