"""From pictures on disk to a finished folder, on a rendered pair with known cameras and changes."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

import scenediff_classic
from data_tools.synthetic_pairs.export import write_pair
from data_tools.synthetic_pairs.splits import split_specs
from scenediff_classic.run_folder import Run
from tests.command import Call, caller, names

SCHEMA = json.loads((Path(scenediff_classic.__file__).parent / "changes.schema.json").read_bytes())
WHOLE = ["changes.json", "geometry", "overlays", "report.html", "run.json", "scores"]
SMALL = ("--preset", "fast", "--long-side", "160")


@dataclass(frozen=True)
class Pair:
    """A rendered pair of captures."""

    folder: Path

    @property
    def captures(self) -> tuple[Path, Path]:
        return self.folder / "before", self.folder / "after"

    @property
    def known(self) -> tuple[str, Path]:
        return "--geometry", self.folder / "truth_geometry.npz"


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Call:
    return caller(capsys)


@pytest.fixture(scope="session")
def truths(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the first `tiny` pair, in which three things changed."""
    root = tmp_path_factory.mktemp("tiny")
    write_pair(split_specs("tiny")[0], root)
    return root


@pytest.fixture(scope="session")
def pair(truths: Path) -> Pair:
    return Pair(truths / "tiny_0000")


@pytest.fixture(scope="session")
def unchanged(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    """The second `tiny` pair, in which nothing changed."""
    root = tmp_path_factory.mktemp("unchanged")
    write_pair(split_specs("tiny")[1], root)
    return Pair(root / "tiny_0001")


def changes(out: Path) -> dict[str, Any]:
    """The result, checked against the published schema."""
    document = json.loads((out / "changes.json").read_bytes())
    jsonschema.Draft202012Validator(SCHEMA).validate(document)
    return document


@pytest.mark.slow
def test_known_geometry_through_every_command(tmp_path: Path, pair: Pair, call: Call) -> None:
    out = tmp_path / "results" / pair.folder.name
    detect = ("detect", *pair.captures, "-o", out, *pair.known, "--long-side", "160")
    first = call(*detect)
    assert first.code == 0, first.err
    assert names(out.parent) == [out.name]
    assert names(out) == WHOLE
    objects = changes(out)["objects"]
    assert objects
    assert json.loads((out / "run.json").read_bytes())["seed"] == 0

    stamps = {p: p.stat().st_mtime_ns for p in out.rglob("*")}
    again = call(*detect)
    assert (again.code, "nothing to do" in again.out) == (0, True)
    assert {p: p.stat().st_mtime_ns for p in out.rglob("*")} == stamps
    assert "another run" in call(*detect, "--threshold.fixed", "0.5").complaint

    for form in ("scenediff", "coco"):
        written = call("export", out, "--format", form)
        assert written.code == 0, written.err
        assert Path(written.out.removeprefix("Wrote ").strip()).stat().st_size > 100

    scored = call("evaluate", out.parent, pair.folder.parent, "--json")
    assert scored.code == 0, scored.err
    assert pair.folder.name in json.dumps(json.loads(scored.out))


@pytest.mark.slow
def test_changed_known_geometry_is_another_run(tmp_path: Path, pair: Pair, call: Call) -> None:
    first, second = (folder / "0002.png" for folder in pair.captures)
    known = two_views(pair, tmp_path / "known.npz")
    detect = ("detect", first, second, "-o", tmp_path / "out", "--geometry", known, *SMALL)
    assert call(*detect).code == 0
    with np.load(known) as stored:
        arrays = dict(stored)
    np.savez(known, **(arrays | {"depth": arrays["depth"] * np.float32(1.01)}))
    assert "another run" in call(*detect).complaint


def two_views(pair: Pair, path: Path) -> Path:
    """The truth of the third picture of each capture, as that of captures of one picture."""
    with np.load(pair.folder / "truth_geometry.npz") as truth:
        per_frame = ("intrinsics", "cam_from_world", "depth")
        rows = [2, len(truth["depth"]) // 2 + 2]
        np.savez(path, **{key: truth[key][rows] for key in per_frame})
    return path


@pytest.mark.slow
def test_two_photos_with_known_geometry(tmp_path: Path, pair: Pair, call: Call) -> None:
    photos = [folder / "0002.png" for folder in pair.captures]
    known = two_views(pair, tmp_path / "known.npz")
    done = call("detect", *photos, "-o", tmp_path / "out", "--geometry", known, *SMALL)
    assert done.code == 0, done.err
    videos = changes(tmp_path / "out")["videos"]
    assert [len(videos[name]["frames"]) for name in ("before", "after")] == [1, 1]


@pytest.mark.slow
@pytest.mark.parametrize("other", ["0002.png", "0005.png"])
def test_two_photos_alone_give_a_result_or_a_reason(
    tmp_path: Path, pair: Pair, call: Call, other: str
) -> None:
    before, after = pair.captures
    outcome = call("detect", before / "0002.png", after / other, "-o", tmp_path / "out", *SMALL)
    if outcome.code == 0:
        changes(tmp_path / "out")
        assert names(tmp_path) == ["out"]
    else:
        assert "aligned" in outcome.complaint or "No depth" in outcome.complaint
        assert names(tmp_path) == []


def start(pair: Pair, out: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "scenediff_classic.cli", "detect"]
    command += [*map(str, pair.captures), "-o", str(out), *SMALL]
    return subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
    )  # fmt: skip


@pytest.mark.slow
def test_a_killed_run_continues_to_the_same_result(tmp_path: Path, pair: Pair) -> None:
    out, other = tmp_path / "killed" / "out", tmp_path / "whole" / "out"
    out.parent.mkdir()
    partial = out.parent / ".out.partial"
    scratch = Run(out, partial, {}).scratch
    running = start(pair, out)
    try:
        finished = wait_for_depth_maps(scratch, 3, running)
    finally:
        running.send_signal(signal.SIGKILL)
        running.wait()
    assert names(out.parent) == [partial.name]
    # the same cameras, and all the rest in one go
    shutil.copytree(partial, other.parent / partial.name)
    shutil.rmtree(Run(other, other.parent / partial.name, {}).scratch / "stereo")

    resumed = start(pair, out)
    seen: dict[str, int] = {}
    while resumed.poll() is None:  # the scratch folder goes away when all is done
        seen |= stamps(scratch)
        time.sleep(0.05)
    assert resumed.returncode == 0
    assert len(seen) > len(finished)
    assert {name: seen[name] for name in finished} == finished
    assert names(out.parent) == ["out"]
    assert names(out) == WHOLE
    assert start(pair, other).wait(timeout=500) == 0
    assert changes(out) == changes(other)


def wait_for_depth_maps(
    scratch: Path, count: int, running: subprocess.Popen[bytes]
) -> dict[str, int]:
    """The first depth maps of a run and when each was finished."""
    while len(found := stamps(scratch)) < count:
        assert running.poll() is None, "the run ended before it was to be killed"
        time.sleep(0.02)
    return found


def stamps(scratch: Path) -> dict[str, int]:
    return {p.name: p.stat().st_mtime_ns for p in (scratch / "stereo").glob("[!.]*.npz")}


@pytest.mark.slow
@pytest.mark.parametrize("source", ["known", "pictures"])
def test_nothing_is_found_where_nothing_changed(
    tmp_path: Path, unchanged: Pair, call: Call, source: str
) -> None:
    geometry = unchanged.known if source == "known" else ()
    detect = ("detect", *unchanged.captures, "-o", tmp_path / "out", "--preset", "fast", *geometry)
    assert call(*detect).code == 0
    assert changes(tmp_path / "out")["objects"] == []
