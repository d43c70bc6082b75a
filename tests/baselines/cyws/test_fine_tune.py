"""Pairs of an annotated benchmark become training pairs, and a network goes on learning there."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.cyws.annotated_pairs import box_of, read_annotated
from baselines.cyws.boxes import areas, iou
from baselines.cyws.fine_tune import FineTune
from baselines.cyws.presets import PRESETS
from baselines.cyws.rendered_folders import read_rendered
from baselines.cyws.training import TrainConfig
from baselines.cyws.weights import load_network, write_weights
from data_tools.synthetic_pairs.export import write_pair
from data_tools.synthetic_pairs.scene import PairSpec
from scenediff_classic.errors import InputError
from scenediff_classic.geometry.known_cameras import KnownGeometry
from scenediff_classic.geometry.store import save_geometry
from scenediff_classic.protocols import silent
from scenediff_classic.types import VIDEOS
from scenediff_classic.video import read_capture

SPEC = PairSpec(
    "x", 7, frames=2, width=160, height=128, close=True, kinds=("removed",), texture_size=256
)
CONFIG = TrainConfig(pairs=4, batch=2, validate_every=2)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A benchmark of one pair, and a run's geometry (the true one)."""
    root = tmp_path_factory.mktemp("benchmark")
    write_pair(SPEC, root / "pairs")
    pair = root / "pairs" / "x"
    captures = [read_capture(pair / video, video) for video in VIDEOS]
    known = KnownGeometry(pair / "truth_geometry.npz", long_side=160)
    geometry = known(captures[0], captures[1], root, silent)
    save_geometry(geometry, root / "runs" / "x" / "geometry")
    return root


def test_boxes_are_where_the_renderer_says(root: Path) -> None:
    truth = read_rendered(root / "pairs" / "x")
    both = list(read_annotated(root / "pairs" / "x", root / "runs" / "x", (128, 160), "both"))
    assert 1 <= len(both) <= 4
    checked = 0
    for pair in both:
        assert len(pair.boxes) <= 1
        for box in pair.boxes:
            assert iou(box[:1], truth.boxes[0, :2]).max() > 0.95  # its own mask
            # carried over is only the side of it that is seen before
            low = np.maximum(box[1, :2], truth.boxes[0, 2:, :2])
            high = np.minimum(box[1, 2:], truth.boxes[0, 2:, 2:])
            common = np.prod(np.maximum(high - low, 0), axis=1)
            assert common.max() > 0.9 * areas(box[1:])[0]
            checked += 1
    assert checked
    standing = list(read_annotated(root / "pairs" / "x", root / "runs" / "x", (128, 160)))
    for one, other in zip(standing, both, strict=True):
        assert np.array_equal(one.boxes[:, 0], other.boxes[:, 0])
        assert not one.boxes[:, 1].any()  # it does not stand in the picture of after


def test_box_of_a_mask() -> None:
    mask = np.zeros((5, 6), bool)
    assert box_of(mask) is None
    mask[1:3, 4] = True
    assert box_of(mask) == (4, 1, 5, 3)


def test_stopped_and_resumed_is_as_in_one_go(root: Path, tmp_path: Path) -> None:
    torch.manual_seed(0)
    start = tmp_path / "start.safetensors"
    # the whole width: with 4 channels at this size PyTorch's oneDNN crashes in the backward pass
    write_weights(PRESETS["cyws2d-small"].build(), start)
    call = FineTune(
        root / "pairs", root / "runs", tmp_path / "whole", start=start, held_out=0,
        options=CONFIG, device="cpu",
    )  # fmt: skip
    whole = call().network.state_dict()
    cut = replace(call, out=tmp_path / "cut")
    replace(cut, until=2)()
    resumed = cut().network.state_dict()
    for name, value in whole.items():
        assert torch.equal(value, resumed[name]), name
    network, preset = load_network(tmp_path / "whole" / "model.safetensors")
    assert preset.architecture == "cyws2d-small"
    assert not network.training
    about = json.loads((tmp_path / "whole" / "curve.json").read_text())
    assert [point["pairs"] for point in about["curve"]] == [2, 4]
    with pytest.raises(InputError, match="other options"):
        replace(call, labels="both")()
    with pytest.raises(InputError, match="no 3d"):
        replace(call, model="3d")()
    with pytest.raises(InputError, match="leaves nothing"):
        replace(call, held_out=1)()
