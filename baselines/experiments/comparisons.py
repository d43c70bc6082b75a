"""Which tables a run has: who is how good, where, under which setting."""

from collections.abc import Sequence

from baselines.experiments.finished import FinishedRun, Score
from baselines.experiments.intervals import COVERAGE
from baselines.experiments.tables import NOTHING, Column, Table, Value, percent, texts

_MINUS = "\N{MINUS SIGN}"


def about(run: FinishedRun, benchmark: str, *more: str) -> str:
    """What every table says of itself: benchmark, mode, number of pairs."""
    count = len(run.pairs(benchmark))
    pairs = f"{count} pair" + ("" if count == 1 else "s")
    return " · ".join((benchmark, f"{run.mode(benchmark)} mode", pairs, *more))


def draws_note(run: FinishedRun) -> str:
    """How the intervals came about."""
    draws = run.about["config"].get("draws", 1000)
    return (
        f"In brackets: {COVERAGE:.0f} % of {draws} bootstrap draws over pairs. Bold: the highest "
        "figure of its column and setting, whether or not intervals overlap."
    )


def headings(run: FinishedRun, benchmark: str) -> dict[str, str]:
    """Key -> heading of a benchmark's figures."""
    found: dict[str, str] = {}
    for score in run.scores:
        if score.benchmark == benchmark:
            found.update(score.headings)
    return found


def main_table(run: FinishedRun, benchmark: str) -> Table:
    """Methods x figures, with intervals; every setting."""
    names = headings(run, benchmark)
    variants = run.variants(benchmark)
    several = len(run.settings) > 1
    rows = []
    for setting, method in variants:
        score = _score(run, benchmark, setting, method)
        rivals = [_score(run, benchmark, s, m) for s, m in variants if s == setting]
        failed = sum(
            not cell.done
            for cell in run.cells
            if (cell.benchmark, cell.setting, cell.method) == (benchmark, setting, method)
        )
        figures = tuple(
            percent(
                score.metrics.get(key), score.intervals.get(key), best=_best(score, rivals, key)
            )
            for key in names
        )
        head = (Value(method), Value(setting)) if several else (Value(method),)
        rows.append((*head, *figures, Value(str(failed))))
    first = ("method", "setting") if several else ("method",)
    return Table(
        f"main-{benchmark}", "Comparison of methods", about(run, benchmark, "percent"),
        (*_names(first), *(Column(name) for name in names.values()), Column("failed pairs")),
        tuple(rows), (draws_note(run),),
    )  # fmt: skip


def group_table(run: FinishedRun, benchmark: str, key: str) -> Table | None:
    """One figure by group of pairs; None where pairs have no groups."""
    sizes: dict[str, int] = {}
    for group in run.pairs(benchmark).values():
        sizes[group] = sizes.get(group, 0) + 1
    columns = run.columns(benchmark)
    if len(sizes) < 2 or not columns:
        return None
    rows = []
    for group, size in sizes.items():
        found = [_score(run, benchmark, s, m).groups.get(group, {}).get(key) for s, m in columns]
        most = max((f for f in found if f is not None), default=None)
        values = (percent(f, best=f is not None and f == most) for f in found)
        rows.append((Value(group or "none"), Value(str(size)), *values))
    name = headings(run, benchmark).get(key, key)
    return Table(
        f"groups-{benchmark}-{key}", f"{name} by group of pairs",
        about(run, benchmark, _setting_note(run, columns), "percent"),
        (*_names(("group",)), Column("pairs"), *(Column(c) for c in _titles(run, columns))),
        tuple(rows),
        ("Groups of few pairs say little: no intervals are given for them. "
         f"{NOTHING} = nothing to find and nothing reported.",),
    )  # fmt: skip


def ablation_table(run: FinishedRun, benchmark: str, method: str) -> Table | None:
    """Settings as rows, and how far each is from the first one; None with a single setting."""
    names = headings(run, benchmark)
    settings = [s for s, m in run.variants(benchmark) if m == method]
    if len(settings) < 2:
        return None
    base = _score(run, benchmark, settings[0], method).metrics
    rows = []
    for setting in settings:
        score = _score(run, benchmark, setting, method)
        row: list[Value] = [Value(setting)]
        for key in names:
            row.append(percent(score.metrics.get(key), score.intervals.get(key)))
            row.append(Value(_signed(score.metrics.get(key), base.get(key), setting, settings[0])))
        rows.append(tuple(row))
    columns = [c for name in names.values() for c in (Column(name), Column(f"± {name}"))]
    return Table(
        f"ablation-{benchmark}-{method}", f"Settings of {method}", about(run, benchmark, "percent"),
        (*_names(("setting",)), *columns), tuple(rows),
        (f"±: points above or below '{settings[0]}'. {_first_sentence(draws_note(run))} "
         "Intervals of two settings may overlap though one is better on every pair: the command "
         "compare gives intervals of the difference.",),
    )  # fmt: skip


def pair_table(run: FinishedRun, benchmark: str, key: str) -> Table:
    """One figure by pair."""
    columns = run.columns(benchmark)
    rows = []
    for pair, group in run.pairs(benchmark).items():
        values = []
        for setting, method in columns:
            cell = run.cell(benchmark, setting, method, pair)
            found = _score(run, benchmark, setting, method).pairs.get(pair, {}).get(key)
            failed = cell is not None and not cell.done
            values.append(Value("failed") if failed else percent(found))
        rows.append((Value(pair), Value(group or NOTHING), *values))
    name = headings(run, benchmark).get(key, key)
    return Table(
        f"pairs-{benchmark}-{key}", f"{name} by pair",
        about(run, benchmark, _setting_note(run, columns), "percent"),
        (*_names(("pair", "group")), *(Column(c) for c in _titles(run, columns))), tuple(rows),
        (f"{NOTHING} = nothing to find and nothing reported.",),
    )  # fmt: skip


def failure_table(run: FinishedRun) -> Table | None:
    """Every cell without an answer, and why; None if there is none."""
    failed = [cell for cell in run.cells if not cell.done]
    rows = tuple(
        texts(c.benchmark, c.pair, c.method, c.setting, c.reason or "no reason recorded")
        for c in failed
    )
    if not rows:
        return None
    return Table(
        "failures", "Pairs without an answer", f"{len(failed)} of {len(run.cells)} runs",
        _names(("benchmark", "pair", "method", "setting", "reason")), rows,
        ("In strict mode each counts as all missed; in official mode it is left out.",),
    )  # fmt: skip


def _score(run: FinishedRun, benchmark: str, setting: str, method: str) -> Score:
    found = run.score(benchmark, setting, method)
    if found is None:
        raise KeyError(f"{benchmark}, {setting}, {method}")
    return found


def _best(score: Score, rivals: Sequence[Score], key: str) -> bool:
    mine = score.metrics.get(key)
    others = [r.metrics.get(key) for r in rivals]
    return len(rivals) > 1 and mine is not None and all(o is None or mine >= o for o in others)


def _names(headings: Sequence[str]) -> tuple[Column, ...]:
    return tuple(Column(heading, number=False) for heading in headings)


def _titles(run: FinishedRun, columns: Sequence[tuple[str, str]]) -> list[str]:
    """Methods, or settings where only one method was run."""
    methods = {method for _, method in columns}
    return [setting if len(methods) == 1 < len(columns) else method for setting, method in columns]


def column_titles(run: FinishedRun, benchmark: str) -> list[str]:
    """What the answers shown side by side are called."""
    return _titles(run, run.columns(benchmark))


def _setting_note(run: FinishedRun, columns: Sequence[tuple[str, str]]) -> str:
    settings = dict.fromkeys(setting for setting, _ in columns)
    if len(settings) == 1:
        return f"setting {next(iter(settings))}"
    return columns[0][1] if columns else ""


def _signed(value: float | None, base: float | None, setting: str, first: str) -> str:
    if setting == first or value is None or base is None:
        return NOTHING
    points = f"{100 * (value - base):+.1f}"
    return points.replace("-", _MINUS)


def _first_sentence(text: str) -> str:
    return text.split(". ")[0] + "."
