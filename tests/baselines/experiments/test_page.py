"""The page of an experiment and the files beside it."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from baselines.experiments.finished import read_run
from baselines.experiments.page import headline, write_outputs
from scenediff_classic.errors import InputError
from tests.baselines.experiments.finished_run import (
    BENCHMARK,
    METHODS,
    PAIRS,
    SETTINGS,
    write_finished_run,
)


class _Page(HTMLParser):
    """Ids, references and images of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.sources: list[str] = []
        self.unnamed: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.ids += [found["id"] or ""] if "id" in found else []
        if tag in ("a", "link"):
            self.links.append(found.get("href") or "")
        elif "src" in found:
            self.sources.append(found["src"] or "")
            self.unnamed += [] if found.get("alt") else [tag]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, pairs = write_finished_run(tmp_path_factory.mktemp("page"))
    files = write_outputs(folder, pairs)
    assert files[0] == folder / "report.html"
    assert all(path.is_file() for path in files)
    return folder


@pytest.fixture(scope="module")
def text(run: Path) -> str:
    return (run / "report.html").read_text(encoding="utf-8")


def test_the_page_needs_nothing_from_elsewhere(run: Path, text: str) -> None:
    page = _Page(text)
    assert all(source.startswith("data:image/") for source in page.sources)
    for link in page.links:
        if link.startswith("#"):
            assert link[1:] in page.ids
        elif link != "data:,":
            assert (run / unquote(link)).is_file(), link
    outside = re.sub(r'src="data:[^"]*"', "", text)
    assert "http:" not in outside
    assert "https:" not in outside
    assert "@import" not in text
    assert "url(" not in outside


def test_every_id_is_there_once_and_every_picture_is_described(text: str) -> None:
    page = _Page(text)
    assert len(page.ids) == len(set(page.ids))
    assert page.unnamed == []


def test_every_pair_method_setting_and_failure_is_on_the_page(text: str) -> None:
    for name in (*PAIRS, *METHODS, *SETTINGS, "film <more> overlap", "boxes & co", "some <cpu>"):
        escaped = name.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
        assert escaped in text, name
    assert "<found>" not in text
    assert "<more>" not in text
    assert "Published: SceneDiff Benchmark" in text


def test_tables_name_their_benchmark_mode_and_number_of_pairs(run: Path) -> None:
    ours = [p for p in (run / "tables").glob("*.tex") if BENCHMARK in p.name]
    assert len(ours) >= 8
    for path in ours:
        content = path.read_text(encoding="utf-8")
        assert "boxes · strict mode · 2 pairs" in content, path.name


def test_the_main_table_is_what_the_scores_say(run: Path) -> None:
    lines = (run / "tables" / "main-boxes.csv").read_text(encoding="utf-8").splitlines()
    assert lines[1] == "all <found>,default,100.0,50.0,100.0,100.0,50.0,100.0,0"
    assert lines[2] == "first only,default,25.0,12.5,25.0,25.0,12.5,25.0,1"


def test_differences_of_an_ablation_are_to_its_first_setting(run: Path) -> None:
    path = run / "tables" / "ablation-boxes-all-found.csv"
    rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    assert [row[4] for row in rows[1:]] == ["", "\N{MINUS SIGN}25.0", "\N{MINUS SIGN}50.0"]


def test_figures_for_papers_lie_beside_the_page(run: Path) -> None:
    names = {p.relative_to(run / "figures" / "boxes").as_posix()
             for p in (run / "figures").rglob("*") if p.is_file()}  # fmt: skip
    assert {"metrics.pdf", "metrics.svg", "changed-moved/grid.jpg", "quiet/grid.jpg",
            "changed-moved/trajectory.pdf",
            "sensitivity-all-found-core.threshold.pdf"} <= names  # fmt: skip


def test_a_second_call_writes_nothing_until_something_changes(run: Path) -> None:
    page = run / "report.html"
    before = page.stat().st_mtime_ns
    assert write_outputs(run, {})[0] == page
    about = json.loads((run / "experiment.json").read_text())
    (run / "experiment.json").write_text(json.dumps({**about, "finished": "later"}))
    write_outputs(run, {})
    assert page.stat().st_mtime_ns == before


def test_without_its_data_a_run_still_has_a_page(tmp_path: Path) -> None:
    folder, _ = write_finished_run(tmp_path)
    text = write_outputs(folder, {})[0].read_text(encoding="utf-8")
    assert "No pictures: The benchmark no longer has the pair quiet." in text


def test_the_terminal_gets_the_main_table_and_the_failures(run: Path) -> None:
    assert [table.title for table in headline(run)] == [
        "Comparison of methods", "Pairs without an answer",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("experiment.json", {"schema": 2}, "another version"),
        ("experiment.json", {"schema": 1, "name": "x"}, "'config' is missing"),
        ("cells.json", [{"method": "a"}], "'setting' is missing"),
        ("cells.json", {"method": "a"}, "should be a list"),
        ("scores.json", [3], "should be a mapping"),
    ],
)
def test_a_damaged_run_is_named(tmp_path: Path, name: str, content: object, complaint: str) -> None:
    folder, _ = write_finished_run(tmp_path)
    (folder / name).write_text(json.dumps(content))
    with pytest.raises(InputError, match=complaint):
        read_run(folder)


def test_answers_outside_the_run_are_refused(tmp_path: Path) -> None:
    folder, _ = write_finished_run(tmp_path)
    cells = json.loads((folder / "cells.json").read_text())
    cells[0]["output"] = "../../secret"
    (folder / "cells.json").write_text(json.dumps(cells))
    with pytest.raises(InputError, match="inside the run"):
        read_run(folder)
