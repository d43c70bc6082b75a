"""Output folders: whole or absent, resumed after a kill, never mixed up, never someone else's."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from scenediff_classic import run_folder
from scenediff_classic.errors import OutputError
from scenediff_classic.run_folder import Run, open_run
from scenediff_classic.workspace import write_atomic
from tests.privileges import as_nobody

ONE = {"before": "abc", "options": {"fps": 1.0, "sizes": (1, 2)}}
OTHER = {"before": "xyz"}


def result_of(run: Run) -> None:
    """What a pipeline does: some scratch work, a result, a report."""
    write_atomic(run.scratch / "features.bin", b"\0" * 1000)
    write_atomic(run.folder / "geometry" / "points.ply", "points")
    write_atomic(run.folder / "changes.json", "{}")


def complete_run(out: Path, fingerprint: dict, overwrite: bool = False) -> None:
    with open_run(out, fingerprint, overwrite) as run:
        assert not run.already_done
        result_of(run)
        run.finish()


def tree(folder: Path) -> set[str]:
    return {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}


WHOLE = {"geometry/points.ply", "changes.json", "run.json"}


def test_names_need_not_be_valid_unicode(tmp_path: Path) -> None:
    odd = {"before": "room\udcff.mp4"}
    complete_run(tmp_path / "out", odd)
    assert json.loads((tmp_path / "out" / "run.json").read_text())["fingerprint"] == odd
    with open_run(tmp_path / "out", odd) as again:
        assert again.already_done


def test_the_result_appears_at_once_and_alone(tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    with open_run(out, ONE) as run:
        assert not run.resumed
        result_of(run)
        assert not out.exists()
        run.finish()
    assert tree(tmp_path) == {f"new/out/{name}" for name in WHOLE}
    assert os.listdir(out.parent) == ["out"]


def test_an_empty_folder_is_taken(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    complete_run(tmp_path / "out", ONE)
    assert tree(tmp_path / "out") == WHOLE


def test_a_link_to_a_folder_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    complete_run(tmp_path / "link", ONE)
    assert (tmp_path / "link").is_symlink()
    assert tree(tmp_path / "real") == WHOLE


def test_a_finished_run_is_recognised(tmp_path: Path) -> None:
    complete_run(tmp_path / "out", ONE)
    with open_run(tmp_path / "out", ONE) as run:
        assert run.already_done
        assert run.folder == tmp_path / "out"
        run.finish()
    assert tree(tmp_path / "out") == WHOLE


def test_run_json_keeps_what_was_written_and_gains_the_fingerprint(tmp_path: Path) -> None:
    with open_run(tmp_path / "out", ONE) as run:
        write_atomic(run.folder / "run.json", json.dumps({"schema": 1, "seed": 3}))
        run.finish()
    document = json.loads((tmp_path / "out" / "run.json").read_text())
    assert document == {"schema": 1, "seed": 3, "fingerprint": json.loads(json.dumps(ONE))}


def test_an_interrupted_run_is_continued(tmp_path: Path) -> None:
    with open_run(tmp_path / "out", ONE) as run:
        write_atomic(run.folder / "stage.txt", "done")
        (run.folder / ".torn.npz.tmp").write_text("half")
        write_atomic(run.folder / "run.json", json.dumps({"schema": 1, "fingerprint": {}}))
    assert not (tmp_path / "out").exists()
    with open_run(tmp_path / "out", ONE) as run:
        assert run.resumed
        assert (run.folder / "stage.txt").read_text() == "done"
        assert not (run.folder / ".torn.npz.tmp").exists()
        run.finish()
    assert tree(tmp_path / "out") == {"stage.txt", "run.json"}


def test_an_interrupted_run_of_other_inputs_is_discarded(tmp_path: Path) -> None:
    with open_run(tmp_path / "out", OTHER) as run:
        result_of(run)
    with open_run(tmp_path / "out", ONE) as run:
        assert not run.resumed
        assert tree(run.folder) == {".unfinished.json"}


def test_a_run_that_did_nothing_leaves_nothing(tmp_path: Path) -> None:
    def fail() -> None:
        with open_run(tmp_path / "out", ONE):
            raise ValueError("no such input")

    with pytest.raises(ValueError, match="no such input"):
        fail()
    assert os.listdir(tmp_path) == []


def test_another_run_is_replaced_only_on_request(tmp_path: Path) -> None:
    out = tmp_path / "out"
    complete_run(out, OTHER)
    before = (out / "run.json").read_bytes()
    with pytest.raises(OutputError, match=r"out holds another run.*--overwrite"):
        open_run(out, ONE)
    with open_run(out, ONE, overwrite=True) as run:
        write_atomic(run.folder / "new.txt", "new")
        assert (out / "run.json").read_bytes() == before  # kept until the new one is finished
        run.finish()
    assert tree(out) == {"new.txt", "run.json"}
    assert os.listdir(tmp_path) == ["out"]


def test_overwriting_repeats_a_finished_run(tmp_path: Path) -> None:
    complete_run(tmp_path / "out", ONE)
    complete_run(tmp_path / "out", ONE, overwrite=True)


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize(
    "files",
    [
        {"thesis.tex": "years of work"},
        {"run.json": "not ours"},
        {"run.json": '{"schema": 1}', "thesis.tex": "years of work"},
        {"run.json": '["schema", "fingerprint"]'},
        {".unfinished.json": '{"schema": 1, "fingerprint": {}}'},
    ],
)
def test_other_files_are_never_touched(tmp_path: Path, files: dict, overwrite: bool) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for name, text in files.items():
        (out / name).write_text(text)
    with pytest.raises(OutputError, match=r"out holds other files.*choose another"):
        open_run(out, ONE, overwrite)
    assert {p.name: p.read_text() for p in out.iterdir()} == files
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.parametrize("role", ["partial", "replaced"])
def test_hidden_folders_of_others_are_never_touched(tmp_path: Path, role: str) -> None:
    hidden = tmp_path / f".out.{role}"
    hidden.mkdir()
    (hidden / "thesis.tex").write_text("years of work")
    complete_run(tmp_path / "elsewhere", ONE)
    with pytest.raises(OutputError, match=rf"\.out\.{role} is in the way"):
        complete_run(tmp_path / "out", ONE)
    assert (hidden / "thesis.tex").read_text() == "years of work"


def test_impossible_places_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "loop").symlink_to("loop")
    inside = tmp_path / "inside"
    inside.mkdir()
    monkeypatch.chdir(inside)
    for out, message in [
        (tmp_path / "file", "file is a file"),
        (tmp_path / "file" / "out", "file/out cannot be written"),
        (tmp_path / "loop", "loop cannot be written"),
        (tmp_path / ("x" * 300), "cannot be written: File name too long"),
        (Path("."), "current folder.*choose a folder inside"),
        (Path("/"), "root of a disk"),
        (Path("/proc/out"), "/proc/out cannot be written"),
    ]:
        with pytest.raises(OutputError, match=message) as caught:
            open_run(out, ONE)
        assert "\n" not in str(caught.value)


def test_a_folder_without_permission_is_named() -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o555)
        with (
            as_nobody(),
            pytest.raises(OutputError, match="out cannot be written: there is no permission"),
        ):
            open_run(Path(name) / "out", ONE)


def test_something_put_at_out_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with open_run(out, ONE) as run:
        result_of(run)
        out.mkdir()
        (out / "thesis.tex").touch()
        with pytest.raises(OutputError, match="something else was put there"):
            run.finish()
    (out / "thesis.tex").unlink()
    with open_run(out, ONE) as run:
        assert run.resumed


CHILD = """
import sys, time
from pathlib import Path
from scenediff_classic.run_folder import open_run
from scenediff_classic.workspace import write_atomic
out, overwrite, pause = Path(sys.argv[1]), sys.argv[2] == "overwrite", float(sys.argv[3])
print("ready", flush=True)
with open_run(out, {"input": sys.argv[4]}, overwrite) as run:
    for number in range(20):
        path = run.folder / "depth" / f"{number}.txt"
        if not path.exists():
            write_atomic(path, str(number) * 50_000)
        write_atomic(run.scratch / f"{number}.txt", "x")
        time.sleep(pause)
    run.finish()
"""


def start(out: Path, pause: float, fingerprint: str, mode: str = "") -> subprocess.Popen[str]:
    arguments = [sys.executable, "-c", CHILD, str(out), mode, str(pause), fingerprint]
    child = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n", child.communicate()
    return child


def check_whole(out: Path) -> None:
    names = {f"depth/{n}.txt" for n in range(20)} | {"run.json"}
    assert tree(out) - {p for p in tree(out) if p.startswith(".")} == names
    for number in range(20):
        assert (out / "depth" / f"{number}.txt").read_text() == str(number) * 50_000


def test_two_runs_at_once_are_refused(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with open_run(out, ONE) as run:
        result_of(run)
        for fingerprint in (ONE, OTHER):
            with pytest.raises(OutputError, match=r"Another run is writing to .*out now"):
                open_run(out, fingerprint)
        child = start(out, 0, "a")
        _, complaint = child.communicate(timeout=60)
        assert child.returncode == 1
        assert "Another run is writing" in complaint
        assert tree(run.folder) >= {"changes.json"}


@pytest.mark.slow
def test_a_run_killed_at_any_moment_is_whole_or_absent_and_resumes(tmp_path: Path) -> None:
    """Moments are spread evenly from the start of the work to beyond its end."""
    out = tmp_path / "out"
    for attempt in range(8):
        child = start(out, 0.002, "a" if attempt % 4 else "b", "overwrite")
        time.sleep(attempt * 0.018)
        child.send_signal(signal.SIGKILL)
        child.communicate(timeout=60)
        if out.exists():
            check_whole(out)
    child = start(out, 0, "a", "overwrite")
    assert child.communicate(timeout=60) == ("", "")
    check_whole(out)
    assert os.listdir(tmp_path) == ["out"]
    assert not list(out.rglob(".*"))


class KilledError(BaseException):
    """Stands for the end of the process."""


def killed_after(monkeypatch: pytest.MonkeyPatch, steps: int) -> None:
    """Make the process "die" at a later change to the file system: all that follow fail."""
    left = [steps]

    def dying(change):
        def call(*arguments, **options):
            left[0] -= 1
            if left[0] < 0:
                raise KilledError
            return change(*arguments, **options)

        return call

    for owner, name in [
        (Path, "rename"), (Path, "replace"), (Path, "unlink"), (Path, "rmdir"), (Path, "mkdir"),
        (run_folder.shutil, "rmtree"),
    ]:  # fmt: skip
        monkeypatch.setattr(owner, name, dying(getattr(owner, name)))


def test_death_between_any_two_steps_loses_and_mixes_nothing(tmp_path: Path) -> None:
    """Deterministic twin of the kill test: dies once after each single file system change."""
    for steps in range(60):
        out = tmp_path / str(steps) / "out"
        complete_run(out, OTHER)
        survived = False
        with pytest.MonkeyPatch.context() as monkeypatch, suppress(KilledError):
            killed_after(monkeypatch, steps)
            complete_run(out, ONE, overwrite=True)
            survived = True
        if out.exists():
            assert tree(out) >= WHOLE
        with open_run(out, ONE, overwrite=not survived) as run:
            if not survived:
                result_of(run)
                run.finish()
        assert tree(out) == WHOLE
        assert json.loads((out / "run.json").read_text())["fingerprint"]["before"] == "abc"
        assert os.listdir(out.parent) == ["out"]
        if survived:
            break
    assert survived
    assert steps > 10
