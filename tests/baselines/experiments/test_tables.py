"""One table, four looks."""

import csv
import io
from html.parser import HTMLParser
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from baselines.experiments.published import published_seconds, published_tables
from baselines.experiments.tables import (
    Column,
    Table,
    Value,
    percent,
    stem,
    tex,
    to_csv,
    to_html,
    to_latex,
    to_rich,
    write_table,
)

SMALL = Table(
    "main-val_a", "Who & how well", "val_a · strict mode · 2 pairs",
    (Column("method", number=False), Column("px/im IoU"), Column("failed")),
    (
        (Value("ours_<1>"), percent(0.825, (0.71, 0.9), best=True), Value("0")),
        (Value("theirs"), percent(None), Value("1")),
    ),
    ("100 % ours.",),
)  # fmt: skip


def test_csv() -> None:
    assert to_csv(SMALL) == (
        "method,px/im IoU,px/im IoU low,px/im IoU high,failed\n"
        "ours_<1>,82.5,71.0,90.0,0\n"
        "theirs,,,,1\n"
    )


def test_latex() -> None:
    assert (
        to_latex(SMALL)
        == r"""\begin{table}
\centering
\caption{Who \& how well. val\_a · strict mode · 2 pairs. 100 \% ours.}
\label{tab:main-val-a}
\begin{tabular}{lrr}
\toprule
method & px/im IoU & failed \\
\midrule
ours\_\textless{}1\textgreater{} & \textbf{82.5} {\scriptsize [71.0, 90.0]} & 0 \\
theirs & -- & 1 \\
\bottomrule
\end{tabular}
\end{table}
"""
    )


def test_html() -> None:
    found = to_html(SMALL)
    assert '<th scope="row">ours_&lt;1&gt;</th>' in found
    assert (
        '<td class="number"><strong>82.5</strong> <small class="interval">[71.0, 90.0]</small></td>'
    ) in found
    assert "<b>Who &amp; how well</b>" in found
    assert "<1>" not in found


def test_terminal() -> None:
    stream = io.StringIO()
    Console(file=stream, width=100).print(to_rich(SMALL))
    shown = stream.getvalue()
    for text in ("Who & how well", "ours_<1>", "82.5", "[71.0, 90.0]", "strict mode", "2 pairs"):
        assert text in shown


class _Text(HTMLParser):
    """All text of a piece of HTML."""

    def __init__(self) -> None:
        super().__init__()
        self.text = ""

    def handle_data(self, data: str) -> None:
        self.text += data


@given(st.text(st.characters(exclude_categories=("C",)), min_size=1, max_size=30))
def test_any_name_survives_every_look(name: str) -> None:
    table = Table("k", "t", "a", (Column("n", number=False),), ((Value(name),),))
    parser = _Text()
    parser.feed(to_html(table))
    assert name in parser.text
    assert next(csv.reader(io.StringIO(to_csv(table).split("\n", 1)[1]))) == [name]


@given(st.text(alphabet="\\{}$&#%_^~<>ab"))
def test_latex_has_no_bare_special_character(text: str) -> None:
    kept = tex(text)
    for known in (r"\textbackslash{}", r"\textasciicircum{}", r"\textasciitilde{}",
                  r"\textless{}", r"\textgreater{}", *(f"\\{c}" for c in "{}$&#%_")):  # fmt: skip
        kept = kept.replace(known, "")
    assert set(kept) <= set("ab")


def test_names_of_files_stay_in_their_folder(tmp_path: Path) -> None:
    table = Table("../ab/c d", "t", "a", (Column("n"),), ((Value("1"),),))
    assert [p.parent for p in write_table(table, tmp_path)] == [tmp_path] * 3
    assert stem("../..") == "unnamed"


def test_a_row_of_the_wrong_length_is_refused() -> None:
    with pytest.raises(ValueError, match="2 values for 1 columns"):
        Table("k", "t", "a", (Column("n"),), ((Value("1"), Value("2")),))


@pytest.mark.parametrize("kind", ["scenediff", "paslcd", "rc3d", "changesim", "synthetic"])
def test_published_tables_say_what_they_are(kind: str) -> None:
    for table in (*published_tables(kind), published_seconds()):
        assert table.title.startswith("Published: ")
        assert "never computed here" in table.notes[0]


def test_published_figures_are_the_paper_s() -> None:
    """Rows of the paper's main table."""
    varied, kitchen = published_tables("scenediff")
    assert [v.text for v in varied.rows[0]] == ["SceneDiff", "39.1", "43.8", "22.8", "18.5"]
    assert [v.text for v in kitchen.rows[1]] == ["3DGS-CD", "4.8", "0.1", "0.1", "0.1"]
    *_, ablation = published_tables("synthetic", ablation=True)
    assert [v.text for v in ablation.rows[0]][1:] == ["39.1", "43.8", "22.8"]
    assert [v.text for v in ablation.rows[5]] == ["geometry cue only", "+2.1", "-12.1", "-10.3"]
