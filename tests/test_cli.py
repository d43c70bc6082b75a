"""Bad input and bad options at the command line: one sentence, exit code 2, nothing left over."""

import errno
import json
import os
import shutil
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scenediff_classic import cli, devices
from scenediff_classic.pipeline import DetectConfig
from tests.command import Call, caller, names
from tests.films import write_film
from tests.privileges import as_nobody

HEIGHT, WIDTH = 96, 128


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Call:
    return caller(capsys)


def test_every_stage_of_the_method_has_its_options() -> None:
    stages = {field.name for field in fields(DetectConfig)}
    assert stages - {field.name for field in fields(cli.Detect)} == {"confidence"}  # constants


def picture(seed: int) -> np.ndarray:
    """Smooth blobs of random colour: texture to find key points in, unlike any other seed's."""
    small = np.random.default_rng(seed).integers(0, 256, (HEIGHT // 6, WIDTH // 6, 3), np.uint8)
    return np.asarray(Image.fromarray(small).resize((WIDTH, HEIGHT), Image.Resampling.BICUBIC))


def photos(folder: Path, *seeds: int) -> Path:
    folder.mkdir()
    for number, seed in enumerate(seeds):
        Image.fromarray(picture(seed)).save(folder / f"{number:04d}.png")
    return folder


@pytest.fixture
def before(tmp_path: Path) -> Path:
    return photos(tmp_path / "before", 1, 2, 3)


@pytest.fixture
def after(tmp_path: Path) -> Path:
    return photos(tmp_path / "after", 4, 5, 6)


def geometry_file(path: Path, frames: int = 6, **other: np.ndarray) -> Path:
    """Cameras side by side in front of a slanted wall, one per frame; says nothing true."""
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 0, 3] = -0.05 * np.arange(frames)
    ramp = np.linspace(1.5, 2.5, WIDTH, dtype=np.float32)
    arrays = {
        "intrinsics": np.tile([[110.0, 0, 64], [0, 110, 48], [0, 0, 1]], (frames, 1, 1)),
        "cam_from_world": poses,
        "depth": np.broadcast_to(ramp, (frames, HEIGHT, WIDTH)),
    }
    np.savez(path, **(arrays | other))
    return path


def bad_captures(folder: Path) -> dict[str, Path]:
    """Name of what is wrong -> a capture of that kind."""
    made = {
        name: folder / name
        for name in (
            "missing.mp4",
            "text.mp4",
            "empty.mp4",
            "cut.mp4",
            "hollow.mp4",
            "black.png",
            "broken.png",
        )
    }
    made["text.mp4"].write_text("This is a shopping list: bread, milk, apples.\n" * 20)
    made["empty.mp4"].touch()
    film = write_film(folder / "film.mp4", [0, 100, 200]).read_bytes()
    made["cut.mp4"].write_bytes(film[: len(film) // 2])
    index_first = {"movflags": "faststart"}
    film = write_film(
        folder / "film.mp4", [0, 100, 200], container_options=index_first
    ).read_bytes()
    made["hollow.mp4"].write_bytes(film[: film.index(b"mdat") + 4])
    Image.fromarray(np.zeros((HEIGHT, WIDTH, 3), np.uint8)).save(made["black.png"])
    Image.fromarray(picture(9)).save(made["broken.png"])
    whole = made["broken.png"].read_bytes()
    made["broken.png"].write_bytes(whole[: len(whole) // 2])
    made["nothing"] = photos(folder / "nothing")
    made["notes"] = photos(folder / "notes")
    (made["notes"] / "notes.txt").write_text("Remember the keys.")
    made["one broken"] = photos(folder / "one broken", 7)
    shutil.copy(made["broken.png"], made["one broken"] / "0001.png")
    return made


BAD_CAPTURES = {
    "missing.mp4": "does not exist",
    "text.mp4": "neither a picture nor a video",
    "empty.mp4": "is empty",
    "cut.mp4": "no picture track: it is a sound file, or damaged",
    "hollow.mp4": "hollow.mp4",
    "black.png": "entirely black",
    "broken.png": "is a damaged picture",
    "nothing": "is an empty folder",
    "notes": "holds no pictures",
    "one broken": "0001.png is a damaged picture",
}


@pytest.mark.parametrize("kind", BAD_CAPTURES)
@pytest.mark.parametrize("which", ["before", "after"])
def test_a_bad_capture_is_named_in_one_sentence(
    tmp_path: Path, before: Path, call: Call, kind: str, which: str
) -> None:
    bad = bad_captures(tmp_path)[kind]
    present = names(tmp_path)
    given = (bad, before) if which == "before" else (before, bad)
    complaint = call("detect", *given, "-o", tmp_path / "out").complaint
    assert str(bad) in complaint
    assert BAD_CAPTURES[kind] in complaint
    assert names(tmp_path) == present


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--fps", "0"], "frame rate"),
        (["--fps", "nan"], "frame rate"),
        (["--long-side", "5"], "long side must be at least 64"),
        (["--long-side", "-100"], "long side must be at least 64"),
        (["--seed", "-1"], "seed must be from 0"),
        (["--seed", str(2**40)], "seed must be from 0"),
        (["--before-range", "2", "1"], "end after its start"),
        (["--after-range", "-3", "1"], "start at 0 s or later"),
        (["--before-range", "0", "1"], "no range in seconds"),
        (["--before-ignore", "nowhere"], "nowhere does not exist"),
        (["--device", "cuda"], "no CUDA device"),
        (["--scoring.voxel", "0"], "scoring.voxel must be above 0"),
        (["--scoring.visibility.depth-edge", "nan"], "finite number"),
        (["--objects.min-area", "-1"], "objects.min_area"),
        (["--geometry", "nowhere"], "nowhere does not exist"),
        (["--learned-matching", "nowhere"], "aliked-n16rot.onnx is missing"),
    ],
)
def test_a_bad_option_is_named_in_one_sentence(
    tmp_path: Path, before: Path, after: Path, call: Call, monkeypatch: pytest.MonkeyPatch,
    options: list[str], expected: str,
) -> None:  # fmt: skip
    monkeypatch.setattr(devices, "cuda_available", lambda: False)
    complaint = call("detect", before, after, "-o", tmp_path / "out", *options).complaint
    assert expected in complaint
    assert names(tmp_path) == ["after", "before"]


@pytest.mark.parametrize("options", [["--preset", "best"], ["--fps", "many"], ["--nonsense", "1"]])
def test_an_option_that_cannot_be_parsed_shows_what_could(
    tmp_path: Path, before: Path, after: Path, call: Call, options: list[str]
) -> None:
    outcome = call("detect", before, after, "-o", tmp_path / "out", *options)
    assert outcome.code == 2
    assert options[0] in outcome.out + outcome.err
    assert "Traceback" not in outcome.out + outcome.err
    assert names(tmp_path) == ["after", "before"]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ({"depth": np.ones((6, 2))}, "do not fit together"),
        ({"cam_from_world": np.full((6, 4, 4), np.nan)}, ""),
        ({"video": np.full(6, 7)}, ""),
    ],
)
def test_known_geometry_with_bad_arrays(
    tmp_path: Path, before: Path, after: Path, call: Call, content: dict[str, Any], expected: str
) -> None:
    known = geometry_file(tmp_path / "known.npz", **content)
    complaint = call("detect", before, after, "-o", tmp_path / "out", "--geometry", known).complaint
    assert "known.npz" in complaint
    assert expected in complaint
    assert names(tmp_path) == ["after", "before", "known.npz"]


def test_known_geometry_of_other_captures(
    tmp_path: Path, before: Path, after: Path, call: Call
) -> None:
    known = geometry_file(tmp_path / "known.npz", frames=7)
    out = tmp_path / "out"
    assert "known.npz" in call("detect", before, after, "-o", out, "--geometry", known).complaint
    assert names(tmp_path) == ["after", "before", "known.npz"]


@pytest.mark.parametrize("foreign", ["notes.npz", "folder", "notes.txt"])
def test_known_geometry_that_is_something_else(
    tmp_path: Path, before: Path, after: Path, call: Call, foreign: str
) -> None:
    path = tmp_path / foreign
    if path.suffix:
        path.write_text("Remember the keys.")
    else:
        photos(path, 1)
    out = tmp_path / "out"
    assert foreign in call("detect", before, after, "-o", out, "--geometry", path).complaint
    assert names(tmp_path) == sorted(["after", "before", foreign])


def test_captures_without_overlap_cannot_be_aligned(
    tmp_path: Path, before: Path, after: Path, call: Call
) -> None:
    assert (
        "could not be aligned"
        in call("detect", before, after, "-o", tmp_path / "out", "--long-side", "128").complaint
    )
    assert names(tmp_path) == ["after", "before"]


def test_frames_without_parallax_cannot_be_aligned(tmp_path: Path, call: Call) -> None:
    before, after = photos(tmp_path / "before", 1, 1), photos(tmp_path / "after", 1, 1)
    complaint = call("detect", before, after, "-o", tmp_path / "out").complaint
    assert "no parallax" in complaint
    assert names(tmp_path) == ["after", "before"]


def test_an_out_that_is_a_file_stays(tmp_path: Path, before: Path, after: Path, call: Call) -> None:
    out = tmp_path / "out"
    out.write_text("mine")
    assert "is a file" in call("detect", before, after, "-o", out).complaint
    assert out.read_text() == "mine"
    assert names(tmp_path) == ["after", "before", "out"]


@pytest.mark.parametrize("options", [[], ["--overwrite"]])
def test_foreign_files_in_out_stay(
    tmp_path: Path, before: Path, after: Path, call: Call, options: list[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("mine")
    complaint = call("detect", before, after, "-o", out, *options).complaint
    assert "other files (thesis.tex)" in complaint
    assert names(out) == ["thesis.tex"]
    assert names(tmp_path) == ["after", "before", "out"]


def test_an_out_without_permission(tmp_path: Path, before: Path, after: Path, call: Call) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o555)
    above = [p for p in tmp_path.parents if any("pytest" in part for part in p.parts)]
    for folder in (*above, tmp_path, before, after):
        folder.chmod(0o755)
    with as_nobody():
        complaint = call("detect", before, after, "-o", closed / "out").complaint
    assert "no permission to write" in complaint
    assert names(closed) == []


@pytest.mark.parametrize("room", [0, 4])
def test_a_full_disk_is_explained_and_the_same_call_finishes(
    tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    before, after = photos(tmp_path / "before", 1, 2), photos(tmp_path / "after", 4)
    known = geometry_file(tmp_path / "known.npz", frames=3)
    arguments = ("detect", before, after, "-o", tmp_path / "out", "--geometry", known)
    arguments += ("--long-side", "64")
    flush, flushed = os.fsync, iter(range(room))

    def fill(descriptor: int) -> None:
        if next(flushed, None) is None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(descriptor)

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", fill)
        assert "disk is full" in call(*arguments).complaint
    assert names(tmp_path) == [".out.partial"] * (room > 0) + ["after", "before", "known.npz"]
    assert call(*arguments).code == 0
    whole = ["changes.json", "geometry", "overlays", "report.html", "run.json", "scores"]
    assert names(tmp_path / "out") == whole
    assert names(tmp_path) == ["after", "before", "known.npz", "out"]


def test_brackets_and_broken_names_are_shown_as_they_are(tmp_path: Path, call: Call) -> None:
    path = tmp_path / "[red]room[/blue] \udcff.mp4"
    complaint = call("detect", path, path, "-o", tmp_path / "out").complaint
    assert "[red]room[/blue] \\udcff.mp4 does not exist." in complaint


@pytest.mark.parametrize(
    "arguments",
    [["evaluate", "nowhere", "nowhere"], ["export", "nowhere"], ["export", "."]],
)
def test_the_other_commands_explain_missing_folders(
    tmp_path: Path, call: Call, arguments: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(*arguments).complaint
    assert names(tmp_path) == []


def test_an_interrupted_run_says_how_to_go_on(
    tmp_path: Path, before: Path, after: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "detect_changes", interrupted)
    outcome = call("detect", before, after, "-o", tmp_path / "out")
    assert outcome.code == 130
    assert "The same call continues" in outcome.err
    assert names(tmp_path) == ["after", "before"]


def test_help_names_the_commands(call: Call) -> None:
    outcome = call("--help")
    assert outcome.code == 0
    assert all(name in outcome.out for name in ("detect", "evaluate", "export"))


def test_as_a_process_of_its_own(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "scenediff_classic.cli", "detect", "no", "no", "-o", "out"]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.strip() == "Error: no does not exist."
    assert names(tmp_path) == []


def test_numba_is_told_to_use_openmp_before_it_is_loaded() -> None:
    program = (
        "import scenediff_classic, sys; assert 'numba' not in sys.modules;"
        "import json, numba; print(json.dumps(numba.config.THREADING_LAYER_PRIORITY))"
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_THREADING")}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=Path(__file__).parents[1], env=environment,
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    assert json.loads(done.stdout) == ["omp", "workqueue", "tbb"]


def test_a_reader_that_stops_early_gets_no_traceback() -> None:
    read, write = os.pipe()
    os.close(read)  # so that the first write finds a broken pipe
    command = [sys.executable, "-m", "scenediff_classic.cli", "detect", "--help"]
    try:
        done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True, check=False)
    finally:
        os.close(write)
    assert (done.returncode, done.stderr) == (1, "")
