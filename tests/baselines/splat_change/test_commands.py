"""Both commands write the usual folder, and continue what was interrupted."""

import json
from pathlib import Path

import cv2
import pytest

from baselines.mv3dcd.__main__ import main as mv3dcd
from baselines.threedgs_cd.__main__ import main as threedgs_cd
from data_tools.synthetic_pairs.export import write_pair
from data_tools.synthetic_pairs.scene import PairSpec
from scenediff_classic.result.reading import read_result
from tests.learned_models import dino, sam

SPEC = PairSpec("x", 9, frames=3, width=128, height=96, close=True, texture_size=256)
QUICK = ["--iterations", "10", "--points", "1500", "--long-side", "96"]


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    root = tmp_path_factory.mktemp("pairs")
    write_pair(SPEC, root)
    pair = root / "x"
    known = ["--geometry", str(pair / "truth_geometry.npz")]
    return [str(pair / "before"), str(pair / "after"), *known, *QUICK]


@pytest.mark.parametrize("published", [False, True])
def test_3dgs_cd(captures: list[str], published: bool, tmp_path: Path) -> None:
    more = ["--as-published"] if published else ["--occupancy-grid", "--every", "2"]
    out, pictures = tmp_path / "out", tmp_path / "pictures"
    code = threedgs_cd([*captures, "-o", str(out), "--pictures", str(pictures), *more])
    assert code == 0
    result = read_result(out / "changes.json")
    assert len(result.before.frames) == 3
    page = (out / "report.html").read_text()
    assert "Captured and rendered" in page
    assert len(page) < 3_000_000
    assert not (out / ".scratch").exists()
    assert len(list(pictures.iterdir())) == (6 if published else 4)
    stages = json.loads((out / "run.json").read_text())["stage_seconds"]
    assert set(stages) == {"geometry", "models", "things"}


@pytest.mark.parametrize("published", [False, True])
def test_mv3dcd(captures: list[str], published: bool, tmp_path: Path) -> None:
    more = ["--as-published", "--augmented-iterations", "3"]
    more = more if published else ["--channel", "closed-form"]
    few = ["--update-iterations", "3", "--channel-iterations", "3"]
    out, masks = tmp_path / "out", tmp_path / "masks"
    assert mv3dcd([*captures, "-o", str(out), "--symmetric", str(masks), *few, *more]) == 0
    result = read_result(out / "changes.json")
    assert all(0 <= o.confidence <= 1 for o in result.objects)
    written = sorted(p.name for p in masks.iterdir())
    assert written == [f"{v}_{k:04d}.png" for v in ("after", "before") for k in range(3)]
    mask = cv2.imread(str(masks / written[0]), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    assert mask.shape == (72, 96)


def test_learned_models(captures: list[str], tmp_path: Path) -> None:
    learned = [
        "--learned-features", str(dino("dinov2", tmp_path / "dino")),
        "--learned-segmenter", str(sam("sam", tmp_path / "sam")),
    ]  # fmt: skip
    out = tmp_path / "out"
    assert threedgs_cd([*captures, *learned, "--every", "2", "-o", str(out)]) == 0
    assert (out / "changes.json").is_file()
    missing = ["--learned-segmenter", str(tmp_path / "none")]
    assert threedgs_cd([*captures, *missing, "-o", str(tmp_path / "other")]) == 2


def test_a_finished_run_is_reused_as_geometry(captures: list[str], tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    assert threedgs_cd([*captures, "-o", str(first)]) == 0
    assert threedgs_cd([*captures[:2], "--geometry", str(first), *QUICK, "-o", str(second)]) == 0
    assert (second / "geometry" / "geometry.json").is_file()


def test_interrupted_models_are_continued(
    captures: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("baselines.threedgs_cd.detector.searched", stop)
        assert threedgs_cd([*captures, "-o", str(out)]) == 130
    assert not out.exists()
    (kept,) = tmp_path.rglob("before.gaussians")
    stamp = kept.stat().st_mtime_ns
    seen = []
    monkeypatch.setattr(
        "baselines.threedgs_cd.detector.write_comparisons", lambda *_: seen.append(kept.stat())
    )
    assert threedgs_cd([*captures, "-o", str(out), "--pictures", str(tmp_path / "p")]) == 0
    assert {s.st_mtime_ns for s in seen} == {stamp}  # finished before: read, not learned again


@pytest.mark.parametrize("option", ["--iterations", "--every", "--points", "--long-side"])
def test_numbers_out_of_range(
    captures: list[str], option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert threedgs_cd([*captures, option, "0", "-o", str(tmp_path / "out")]) == 2
    assert f"{option} must be at least" in capsys.readouterr().err
    assert mv3dcd([*captures, "--channel-iterations", "0", "-o", str(tmp_path / "out")]) == 2
