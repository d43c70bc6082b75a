"""Running experiments with a method that answers at once: what is kept, retried, left out."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from baselines.experiments.__main__ import main
from baselines.experiments.config import read_config
from baselines.experiments.driving import Workers
from baselines.experiments.running import Report, run_experiment
from baselines.experiments.showing import Show
from baselines.experiments.tasks import Outcome, Task, perform
from scenediff_classic.errors import InputError, OutputError
from tests.baselines.experiments.fakes import done, read, write_config


class Here:
    """Does tasks at once, in this process."""

    slots = 1

    def submit(self, task: Task) -> "Future[Outcome]":
        future: Future[Outcome] = Future()
        future.set_result(perform(task))
        return future


@contextmanager
def here(show: Show) -> Iterator[Workers]:
    yield Here()


def run(path: Path, tmp_path: Path, **options: Any) -> Report:
    part = {k: options.pop(k) for k in ("methods", "scenes", "limit") if k in options}
    config = read_config(path).selected(**part)
    return run_experiment(config, tmp_path / "run", tmp_path / "store", here, Show(), **options)


def cells(tmp_path: Path) -> dict[tuple[str, str], dict[str, Any]]:
    return {(c["method"], c["pair"]): c for c in read(tmp_path / "run" / "cells.json")}


def test_everything_is_written_once(tmp_path: Path) -> None:
    path = write_config(tmp_path)
    report = run(path, tmp_path)
    assert (report.cells, report.computed, report.failed) == (6, 6, 0)
    found = cells(tmp_path)
    for (method, pair), cell in found.items():
        assert cell["output"] == f"results/known/{method}/fake/{pair}"
        assert (tmp_path / "run" / cell["output"] / "changes.json").is_file()
        assert cell["stage_seconds"]["guess"] == 0.25
        assert cell["seconds"] == pytest.approx(sum(cell["stage_seconds"].values()))
        assert cell["peak_memory_bytes"] > 0
    scores = {s["method"]: s for s in read(tmp_path / "run" / "scores.json")}
    assert scores["calm"]["metrics"] == {"level": 0.5}
    assert scores["other"]["pairs"]["pair_2"] == {"level": 0.75}
    assert scores["other"]["groups"] == {"even": {"level": 0.75}, "odd": {"level": 0.75}}
    assert scores["other"]["intervals"] == {"level": [0.75, 0.75]}
    about = read(tmp_path / "run" / "experiment.json")
    assert (about["methods"], about["settings"]) == (["calm", "other"], ["known"])
    assert about["finished"] >= about["started"]

    stamps = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*") if p.is_file()}
    again = run(path, tmp_path)
    assert again.computed == 0
    assert {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*") if p.is_file()} == stamps


def test_geometry_is_found_once_for_all_methods(tmp_path: Path) -> None:
    run(write_config(tmp_path), tmp_path)
    assert len(list((tmp_path / "store").glob("pairs/*/geometry-*.json"))) == 3
    folders = [tmp_path / "run/results/known" / m / "fake/pair_1" for m in ("calm", "other")]
    depths = [(f / "geometry/depth/after_00000.npz").read_bytes() for f in folders]
    assert depths[0] == depths[1]
    times = [cells(tmp_path)[m, "pair_1"]["stage_seconds"]["geometry"] for m in ("calm", "other")]
    assert times[0] == times[1] > 0


def test_only_what_changed_is_done_again(tmp_path: Path) -> None:
    run(write_config(tmp_path), tmp_path)
    report = run(write_config(tmp_path, calm="level = 0.25"), tmp_path)
    assert report.computed == 3
    scores = read(tmp_path / "run" / "scores.json")
    assert [s["metrics"]["level"] for s in scores] == [0.25, 0.75]
    picture = tmp_path / "pairs" / "pair_0" / "before" / "0000.png"
    picture.write_bytes((tmp_path / "pairs" / "pair_1" / "before" / "0000.png").read_bytes())
    assert run(write_config(tmp_path, calm="level = 0.25"), tmp_path).computed == 2


def test_a_failing_pair_is_a_miss_and_nothing_more(tmp_path: Path) -> None:
    path = write_config(tmp_path, calm='fails_on = "pair_1"', other='breaks_on = "pair_2"')
    report = run(path, tmp_path)
    assert (report.cells, report.failed) == (6, 2)
    failed, broken = cells(tmp_path)["calm", "pair_1"], cells(tmp_path)["other", "pair_2"]
    assert (failed["status"], failed["output"]) == ("failed", None)
    assert failed["reason"] == "The captures do not overlap."
    assert broken["reason"] == "ZeroDivisionError: an error of the program"
    calm, other = read(tmp_path / "run" / "scores.json")
    assert calm["pairs"]["pair_1"] == {"level": 0.0}
    assert calm["metrics"]["level"] == pytest.approx(0.5 * 2 / 3)
    assert other["metrics"]["level"] == pytest.approx(0.75 * 2 / 3)
    # an error of the input comes again; one of the program may have been put right
    assert run(path, tmp_path).computed == 1
    assert run(path, tmp_path, retry=True).computed == 2


def test_geometry_that_fails_is_why_all_methods_fail(tmp_path: Path) -> None:
    path = write_config(tmp_path)
    (tmp_path / "pairs" / "pair_0" / "known.npz").write_bytes(b"no archive")
    assert run(path, tmp_path).failed == 2
    assert "known.npz" in cells(tmp_path)["other", "pair_0"]["reason"]
    (tmp_path / "pairs" / "pair_1" / "known.npz").unlink()
    assert run(path, tmp_path).failed == 4


def test_parts_of_an_experiment(tmp_path: Path) -> None:
    path = write_config(tmp_path)
    run(path, tmp_path, methods=["other"], limit=2)
    assert set(cells(tmp_path)) == {("other", "pair_0"), ("other", "pair_1")}
    run(path, tmp_path, scenes=["pair_2"])
    assert set(cells(tmp_path)) == {("calm", "pair_2"), ("other", "pair_2")}
    assert run(path, tmp_path).computed == 2
    with pytest.raises(InputError, match="has the pair 'pair_7'"):
        run(path, tmp_path, scenes=["pair_7"])


def test_other_folders_are_left_alone(tmp_path: Path) -> None:
    path = write_config(tmp_path)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "notes.txt").write_text("mine")
    with pytest.raises(OutputError, match="holds other files"):
        run(path, tmp_path)


def test_two_runs_are_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(write_config(tmp_path), tmp_path)
    (tmp_path / "run").rename(tmp_path / "first")
    run(write_config(tmp_path, calm='level = 0.625, fails_on = "pair_2"'), tmp_path)
    code = main(
        ["compare", str(tmp_path / "first"), str(tmp_path / "run"), "-o", str(tmp_path / "out")]
    )
    assert code == 0, capsys.readouterr().err
    calm, other = read(tmp_path / "out" / "compare.json")["compared"]
    level = calm["differences"]["level"]
    assert level["difference"] == pytest.approx((0.125 * 2 - 0.5) / 3)
    assert level["interval"][0] < level["difference"] < level["interval"][1]
    assert (level["better"], level["worse"]) == (["pair_0", "pair_1"], ["pair_2"])
    assert other["differences"]["level"]["difference"] == 0
    assert "known / calm / fake, 3 pairs" in capsys.readouterr().out

    assert main(["compare", str(tmp_path / "first"), str(tmp_path)]) == 2
    assert "is not the folder of a finished experiment" in capsys.readouterr().err


def test_commands_refuse_with_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_config(tmp_path)
    for arguments, complaint in (
        (["run", "nothing.toml"], "cannot be read"),
        (["run", str(path), "--jobs", "0"], "--jobs must be at least 1"),
        (["run", str(path), "--methods", "x"], "there is no 'x'"),
        (["run", str(path), "--data", "rc3d", "x"], "there is no benchmark 'rc3d'"),
    ):
        assert main([*arguments, *(["-o", str(tmp_path / "run")])]) == 2
        shown = capsys.readouterr()
        assert complaint in shown.err
        assert "Traceback" not in shown.err
    assert not (tmp_path / "run").exists()


def command(path: Path, tmp_path: Path, *more: str) -> "subprocess.Popen[bytes]":
    call = [sys.executable, "-m", "baselines.experiments", "run", str(path)]
    return subprocess.Popen(
        [*call, "-o", str(tmp_path / "run"), *more],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])},
    )  # fmt: skip


@pytest.mark.slow
def test_a_killed_run_continues(tmp_path: Path) -> None:
    path = write_config(tmp_path, count=4, other="takes_s = 0.5")
    running = command(path, tmp_path)
    try:
        while len(done(tmp_path)) < 3:
            assert running.poll() is None, running.stderr and running.stderr.read()
            time.sleep(0.02)
    finally:
        running.send_signal(signal.SIGKILL)
        running.communicate()
    finished = len(list((tmp_path / "run" / "results").glob("*/*/*/*/changes.json")))
    assert 0 < finished < 8
    resumed = command(path, tmp_path, "--jobs", "2")
    errors = resumed.communicate()[1].decode()
    assert resumed.returncode == 0, errors
    assert {c["status"] for c in cells(tmp_path).values()} == {"done"}
    assert len(cells(tmp_path)) == 8
    # at most the two that were being written when the run was killed were done twice
    assert 8 <= len(done(tmp_path)) <= 10


@pytest.mark.slow
def test_a_run_that_is_told_to_end_says_how_to_continue(tmp_path: Path) -> None:
    running = command(write_config(tmp_path, count=2, other="takes_s = 30.0"), tmp_path)
    while not done(tmp_path):
        assert running.poll() is None, running.stderr and running.stderr.read()
        time.sleep(0.02)
    running.send_signal(signal.SIGTERM)
    errors = running.communicate()[1].decode()
    assert running.returncode == 130
    assert "The same call continues" in errors
    assert "Traceback" not in errors


@pytest.mark.slow
def test_a_process_that_dies_costs_its_own_cell_only(tmp_path: Path) -> None:
    path = write_config(
        tmp_path, calm='dies_on = "pair_0", dies_once = true', other='dies_on = "pair_1"'
    )
    assert main(["run", str(path), "-o", str(tmp_path / "run")]) == 0
    found = cells(tmp_path)
    assert [k for k, c in found.items() if c["status"] == "failed"] == [("other", "pair_1")]
    assert "ended 2 times without an answer (exit code 3)" in found["other", "pair_1"]["reason"]


@pytest.mark.slow
def test_a_process_that_takes_too_much_memory_is_ended(tmp_path: Path) -> None:
    path = write_config(tmp_path, count=1, other="takes_s = 30.0")
    arguments = ["run", str(path), "-o", str(tmp_path / "run"), "--memory-gib", "0.001"]
    assert main([*arguments, "--methods", "other"]) == 0
    assert "GiB of memory" in cells(tmp_path)["other", "pair_0"]["reason"]
