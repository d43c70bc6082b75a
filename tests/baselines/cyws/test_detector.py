"""The baselines over whole captures: boxes become objects, and the usual folder is written."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.cyws import cli, detector
from baselines.cyws.box_scores import BoxScores
from baselines.cyws.boxes import Boxes, corners_of
from baselines.cyws.detector import CywsConfig, box_mask, detect_with_cyws
from baselines.cyws.presets import PRESETS
from baselines.cyws.raw_boxes import read_boxes
from baselines.cyws.rendered_folders import read_rendered
from baselines.cyws.view_boxes import FoundBox
from baselines.cyws.weights import write_weights
from data_tools.synthetic_pairs.export import write_pair
from data_tools.synthetic_pairs.scene import PairSpec
from scenediff_classic.geometry.known_cameras import KnownGeometry
from scenediff_classic.masks import decode
from scenediff_classic.result.reading import read_result
from scenediff_classic.types import VIDEOS
from scenediff_classic.video import read_capture

SPEC = PairSpec(
    "x", 7, frames=2, width=160, height=128, close=True, kinds=("removed",), texture_size=256
)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("pairs")
    write_pair(SPEC, root)
    return root / "x"


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    network = replace(PRESETS["cyws3d-small"], channels=8).build()
    with torch.no_grad():  # large boxes, wherever the heat has a peak
        network.get_parameter("centernet_head.wh_head.2.bias").fill_(12.0)
    write_weights(network, path)
    return path


def test_true_boxes_become_the_true_object(
    pair: Path, weights: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    truth, one = read_rendered(pair), np.ones(1, np.float32)
    monkeypatch.setattr(
        detector,
        "view_boxes",
        lambda *_: [
            (FoundBox(corners_of(Boxes(truth.boxes[:, k], one), 0), 0.8, None),) for k in range(4)
        ],
    )
    captures = [read_capture(pair / video, video) for video in VIDEOS]
    known = KnownGeometry(pair / "truth_geometry.npz", long_side=160)
    config = CywsConfig(weights=weights, geometry=known)
    result, evidence = detect_with_cyws(captures[0], captures[1], config, workspace=tmp_path)
    (item,) = result.objects  # what the after views box is missing there: no object of theirs
    assert item.kind == "removed"
    assert item.confidence == pytest.approx(0.8)
    assert {v.video for v in item.views} == {"before"}
    stored = np.load(pair / "truth_instances.npz")
    gone = int(stored["id"][stored["kind"] == "removed"][0])
    for view in item.views:
        mask, want = decode(view.mask), stored["instances"][view.frame] == gone
        assert (mask & want).sum() / (mask | want).sum() > 0.4
    assert len(evidence.scores) == 4
    assert evidence.pairs


def test_regions_in_a_box_make_its_mask() -> None:
    labels = np.zeros((10, 10), np.int32)
    labels[2:5, 2:5], labels[4:9, 6:9], labels[0, 0] = 1, 2, -1
    mask = box_mask(labels, (1, 1, 7.2, 6), 0.6)
    assert np.array_equal(mask, labels == 1)
    whole = box_mask(labels, (0, 0, 2, 2), 0.6)  # holds no region
    assert whole.sum() == 4


def test_command_line_writes_the_usual_folder(
    pair: Path, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "x"
    call = [
        str(pair / "before"), str(pair / "after"), "-o", str(out), "--weights", str(weights),
        "--geometry", str(pair / "truth_geometry.npz"), "--least", "0.05", "--device", "cpu",
    ]  # fmt: skip
    assert cli.main("3d", call) == 0
    assert (out / "report.html").is_file()
    assert (out / "geometry" / "geometry.json").is_file()
    result = read_result(out / "changes.json")
    assert result.objects
    assert {o.kind for o in result.objects} <= {"added", "removed"}
    boxes = read_boxes(out / "boxes.json")
    assert {b.here.video for b in boxes} == {"before", "after"}
    assert any(b.partner for b in boxes)
    assert all(b.here.mask.size == (128, 160) for b in boxes)
    rows = BoxScores(tmp_path, pair.parent)()
    # two frames show the object that is gone
    assert {row.truths for row in rows.values()} == {2}
    assert rows["raw boxes"].reported == len(boxes)
    assert rows["raw boxes"].right == rows["raw boxes, ignore rule"].right
    assert cli.main("3d", call) == 0
    assert "holds this very result already" in capsys.readouterr().out
    # the geometry of a finished run serves again
    again = [*call[:3], str(tmp_path / "again"), *call[4:6], "--geometry", str(out), *call[8:]]
    assert cli.main("3d", again) == 0


def test_unusable_weights_are_refused(
    pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    torch.save({"a": torch.zeros(1)}, tmp_path / "w.pt")
    call = [str(pair / "before"), str(pair / "after"), "-o", str(tmp_path / "out")]
    assert cli.main("2d", [*call, "--weights", str(tmp_path / "w.pt")]) == 2
    assert "holds the weights of no CYWS network" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
