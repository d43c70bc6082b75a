"""Rows of the ablation and of the sensitivity curves, on a tiny pair with known changes."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from data_tools.benchmarks import stages
from data_tools.benchmarks.ablation import CUES, SETS, Ablation
from data_tools.benchmarks.rows import Judged
from data_tools.benchmarks.sensitivity import SWEEPS, Sensitivity
from scenediff_classic.errors import InputError
from tests.benchmarks.cards_on_disk import write_cards


def command(root: Path, out: Path) -> Ablation:
    return Ablation(
        root / "pairs", out, root / "work", base="true", features=("gradient-colour", "colours"),
        regions=(), geometry=("true",), oracles=True,
    )  # fmt: skip


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("ablation")
    write_cards(folder / "pairs" / "cards")
    return folder


@pytest.fixture(scope="module")
def judged(root) -> list[Judged]:
    return command(root, root / "out")()


def figures(judged: list[Judged]) -> dict[tuple[str, str, str], object]:
    return {(j.row.group, j.row.name, j.row.variant): j.metrics for j in judged}


def test_a_row_of_cues_has_only_these() -> None:
    rows = [r for r in Ablation(Path(), Path()).rows() if r.group == "cues" and not r.variant]
    assert tuple(row.name for row in rows) == SETS
    for row in rows:
        scoring = row.config(Path()).scoring
        on = {cue for cue, weight in CUES.items() if getattr(scoring, weight) > 0}
        assert on == set(row.name.split(" + "))
        assert (row.config(Path()).objects.min_feature > 0) == ("E_f" in on)


def test_rows_have_folders_of_their_own() -> None:
    folders = [row.folder for row in Ablation(Path(), Path(), oracles=True).rows()]
    assert len(folders) == len(set(folders))


def test_rows_give_different_answers(root, judged) -> None:
    def answer(group: str, name: str) -> bytes:
        row = next(j.row for j in judged if (j.row.group, j.row.name) == (group, name))
        return (root / "out" / "rows" / row.folder / "cards" / "changes.json").read_bytes()

    names = [("as it is", "all cues"), *(("cues", name) for name in SETS), ("features", "colours")]
    answers = [answer(*name) for name in names]
    assert len(set(answers)) == len(answers)
    found = figures(judged)
    assert found["as it is", "all cues", ""].found_objects == 3
    assert found["cues", "E_r", ""].found_objects == 0  # too small a sum for the usual bounds


@pytest.mark.parametrize("stage", ["regions", "features", "scores", "association, status"])
def test_the_truth_in_place_of_a_stage_is_no_worse(judged, stage) -> None:
    found = figures(judged)
    as_it_is, oracle = found["as it is", "all cues", ""], found["one stage true", stage, ""]
    assert oracle.obj_im_ap >= as_it_is.obj_im_ap - 0.01
    assert oracle.obj_sc_ap_typed >= as_it_is.obj_sc_ap_typed - 0.01


def test_tables_and_picture_are_written(root, judged) -> None:
    out = root / "out"
    with (out / "ablation.csv").open() as file:
        rows = list(csv.DictReader(file))
    content = json.loads((out / "ablation.json").read_text())
    assert [r["row"] for r in rows] == [r["row"] for r in content["rows"]]
    assert len(rows) == len({(j.row.group, j.row.name) for j in judged})
    assert float(rows[0]["obj_im_ap"]) == content["rows"][0]["obj_im_ap"]
    assert (out / "ablation.md").read_text().count("\n") == len(rows) + 2
    assert (out / "ablation.png").read_bytes().startswith(b"\x89PNG")


def test_a_second_run_continues_and_agrees(root, judged, monkeypatch) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("this stage was finished")

    monkeypatch.setattr(stages, "score_changes", never)
    lost = next(j.row.folder for j in judged if j.row.name == "E_f")
    shutil.rmtree(root / "out" / "rows" / lost)  # as if killed before it was written
    again = command(root, root / "out")()
    assert figures(again) == figures(judged)
    assert not any(j.failures for j in again)


def test_a_pair_that_fails_counts_as_missed(root, judged, tmp_path) -> None:
    pairs = tmp_path / "pairs"
    shutil.copytree(root / "pairs", pairs)
    shutil.copytree(root / "pairs" / "cards", pairs / "broken")
    (pairs / "broken" / "truth_geometry.npz").unlink()
    both = Ablation(
        pairs, tmp_path / "out", root / "work", base="true", cues=False, features=(), regions=(),
        geometry=(),
    )()  # fmt: skip
    alone = figures(judged)["as it is", "all cues", ""]
    assert list(both[0].failures) == ["broken"]
    assert both[0].metrics.true_objects == 2 * alone.true_objects
    assert both[0].metrics.found_objects == alone.found_objects
    rows = json.loads((tmp_path / "out" / "ablation.json").read_text())["rows"]
    assert rows[0]["failed_pairs"] == 1
    assert "truth_geometry.npz" in rows[0]["failures"]["broken"]


def test_a_changed_pair_is_done_again(root, tmp_path) -> None:
    pairs = tmp_path / "pairs"
    shutil.copytree(root / "pairs", pairs)
    run = Ablation(
        pairs, tmp_path / "out", root / "work", base="true", cues=False, features=(), regions=(),
        geometry=(),
    )  # fmt: skip
    first = run()[0].metrics
    for path in (pairs / "cards" / "before").glob("*.png"):  # now everything looks changed
        Image.fromarray(255 - np.asarray(Image.open(path))).save(path)
    assert run()[0].metrics != first


def test_sensitivity_writes_curves_and_reuses_scores(root, judged, monkeypatch) -> None:
    def never(*_: object, **__: object) -> None:
        raise AssertionError("weights and thresholds need no new scores")

    monkeypatch.setattr(stages, "score_changes", never)
    out = root / "sensitivity"
    symbols = ("lambda_feat", "tau_delta", "sigma_merge", "tau_sim")
    curves = Sensitivity(root / "pairs", out, root / "work", base="true", only=symbols)()
    assert not any(j.failures for j in curves)
    content = json.loads((out / "sensitivity.json").read_text())
    assert content["defaults"]["lambda_feat"] == 0.5
    assert content["defaults"]["tau_delta"] is None
    assert {r["group"] for r in content["rows"]} == {"as it is", *symbols}
    assert (out / "sensitivity.png").read_bytes().startswith(b"\x89PNG")
    by_value = {j.row.name: j.metrics for j in curves if j.row.group == "tau_delta"}
    assert by_value["0.4"].pixels.hit <= by_value["0.08"].pixels.hit


def test_sweeps_name_options_that_exist_and_mark_their_default() -> None:
    config = Ablation(Path(), Path()).configured(Path())
    for sweep in SWEEPS:
        assert sweep.default(config) in (None, *sweep.values), sweep.symbol


def test_an_unknown_symbol_is_refused(root) -> None:
    with pytest.raises(InputError, match="no option tau"):
        Sensitivity(root / "pairs", root / "nothing", only=("tau",))()
