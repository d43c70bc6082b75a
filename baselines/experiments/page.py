"""All that a finished experiment shows: tables, figures, and one page that holds everything."""

import base64
import json
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from rich.table import Table as RichTable

from baselines.experiments.comparisons import failure_table, main_table
from baselines.experiments.finished import FinishedRun, read_run
from baselines.experiments.pair_pictures import FALSE, IDENTITY
from baselines.experiments.published import published_seconds
from baselines.experiments.sections import PICTURED, BenchmarkSection, Plot, benchmark_section
from baselines.experiments.tables import Table, stem, to_html, to_rich, write_table
from data_tools.benchmarks.benchmark import BenchmarkPair
from scenediff_classic.dataset import records
from scenediff_classic.errors import InputError
from scenediff_classic.report.palette import KIND_COLOUR, VIDEO_COLOUR, css, heat_gradient
from scenediff_classic.workspace import write_atomic

_FOLDER = Path(__file__).parent
_REPORT = Path(__file__).parents[2] / "scenediff_classic" / "report"
_TIMES = ("started", "finished")


def write_outputs(
    run: Path,
    pairs: Mapping[str, Sequence[BenchmarkPair]] | None = None,
    *,
    metric: str | None = None,
) -> list[Path]:
    """Write every table, figure and the page of a finished run; see docs/experiments_output.md.

    Nothing is done where the run and this package are as they were when the outputs were written.

    Parameters
    ----------
    run : Path
        Holds ``experiment.json``, ``cells.json`` and ``scores.json``.
    pairs : mapping, optional
        Benchmark -> its pairs; opened from the run's configuration if left out.
    metric : str, optional
        Key of the figure by which the failure gallery is sorted.

    Returns
    -------
    The files, the page first.

    Raises
    ------
    InputError
        If the run is incomplete or damaged. Benchmarks that can no longer be read only cost their
        pictures: the page says why.
    OutputError
        If a file cannot be written.
    """
    finished = read_run(run)
    key = _key(run, metric)
    kept = _kept(run, key)
    if kept is not None:
        return kept
    written: list[Path] = []
    opened = _opened(finished) if pairs is None else pairs
    sections = tuple(
        benchmark_section(finished, name, opened.get(name, ()), metric, written.append)
        for name in finished.benchmarks
        if finished.variants(name)
    )
    failures = failure_table(finished)
    tables = [t for section in sections for t in section.tables]
    tables += [published_seconds(), *([failures] if failures else [])]
    for table in {table.key: table for table in tables}.values():
        written += write_table(table, run / "tables")
    page = run / "report.html"
    write_atomic(page, _html(finished, sections, failures).encode("utf-8", "replace"))
    files = [page, *written]
    names = [path.relative_to(run).as_posix() for path in files]
    write_atomic(run / "outputs.json", json.dumps({"key": key, "files": names}, indent=1) + "\n")
    return files


def headline(run: Path) -> list[RichTable]:
    """The main tables, for the terminal."""
    finished = read_run(run)
    tables = [main_table(finished, b) for b in finished.benchmarks if finished.variants(b)]
    failures = failure_table(finished)
    return [to_rich(table) for table in (*tables, *([failures] if failures else []))]


def _key(run: Path, metric: str | None) -> str:
    """What decides the outputs: the run less its times, and the code that writes them."""
    print_ = sha256(repr(metric).encode())
    about = records.mapping(records.read_json(run / "experiment.json"), "experiment.json")
    lasting = {key: value for key, value in about.items() if key not in _TIMES}
    print_.update(json.dumps(lasting, sort_keys=True).encode())
    for path in (run / "cells.json", run / "scores.json", *sorted(_sources())):
        print_.update(path.read_bytes())
    return print_.hexdigest()


def _sources() -> list[Path]:
    return [p for p in (*_FOLDER.iterdir(), *_REPORT.iterdir()) if p.suffix in _SUFFIXES]


_SUFFIXES = (".py", ".css", ".js", ".html")


def _kept(run: Path, key: str) -> list[Path] | None:
    try:
        content = json.loads((run / "outputs.json").read_text(encoding="utf-8"))
        files = [run / str(name) for name in content["files"]] if content["key"] == key else []
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return files if files and all(path.is_file() for path in files) else None


def _opened(run: FinishedRun) -> dict[str, Sequence[BenchmarkPair]]:
    """The pairs of every benchmark; none where it cannot be opened."""
    from data_tools.benchmarks.named import open_benchmark

    found: dict[str, Sequence[BenchmarkPair]] = {}
    for name, spec in zip(run.benchmarks, run.about["config"].get("benchmarks", []), strict=False):
        try:
            options = spec.get("options") or {}
            found[name] = open_benchmark(spec["kind"], Path(spec["root"]), **options).pairs()
        except (InputError, KeyError, TypeError):
            continue
    return found


def _html(run: FinishedRun, sections: Sequence[BenchmarkSection], failures: Table | None) -> str:
    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["table"] = lambda table: Markup(to_html(table))
    environment.filters["svg_url"] = _svg_url
    environment.filters["stem"] = stem
    style = (_REPORT / "style.css", _FOLDER / "page.css")
    script = (_REPORT / "viewer.js", _FOLDER / "page.js")
    return environment.get_template("page.html").render(
        run=run,
        sections=sections,
        failures=failures,
        published_seconds=published_seconds(),
        facts=_facts(run),
        how=_how(run),
        config=json.dumps(run.about["config"], indent=2, ensure_ascii=False),
        versions=run.about.get("versions") or {},
        pictured=PICTURED,
        identity=[css(colour) for colour in IDENTITY[:4]],
        false=css(FALSE),
        gradient=Markup(heat_gradient()),
        videos={video: css(colour) for video, colour in VIDEO_COLOUR.items()},
        kinds={kind: css(colour) for kind, colour in KIND_COLOUR.items()},
        style=Markup("\n".join(path.read_text(encoding="utf-8") for path in style)),
        script=Markup("\n".join(path.read_text(encoding="utf-8") for path in script)),
    )


def _svg_url(plot: Plot) -> str:
    return "data:image/svg+xml;base64," + base64.b64encode(plot.svg.encode()).decode("ascii")


def _facts(run: FinishedRun) -> list[tuple[str, str]]:
    failed = sum(not cell.done for cell in run.cells)
    pairs = sum(len(run.pairs(name)) for name in run.benchmarks)
    return [
        ("methods", str(len(run.methods))),
        ("settings", str(len(run.settings))),
        ("pairs", str(pairs)),
        ("runs", str(len(run.cells))),
        ("of them failed", str(failed)),
    ]


def _how(run: FinishedRun) -> list[tuple[str, str]]:
    """How it was run, in words."""
    about, machine = run.about, run.about.get("machine")
    lines = []
    if about.get("command"):
        command: Any = about["command"]
        lines.append(("command", command if isinstance(command, str) else " ".join(command)))
    lines.append(("seed", str(about.get("seed", "not recorded"))))
    if isinstance(machine, dict):
        memory = machine.get("memory_bytes")
        parts = [str(machine.get("cpu") or "unknown processor"), f"{machine.get('cores')} cores"]
        parts += [f"{memory / 1e9:.0f} GB"] if isinstance(memory, int | float) else []
        lines.append(("machine", ", ".join((*parts, str(machine.get("platform") or "")))))
    lines += [(key, str(about[key])) for key in _TIMES if about.get(key)]
    lines.append(("state of the program", str(about.get("git_commit") or "not recorded")))
    return lines
