"""Training goes on where it stopped, and a seed decides it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.cyws.curve import CurvePoint, draw_curve
from baselines.cyws.decoder import HeadMaps
from baselines.cyws.evaluate import Evaluate, judge
from baselines.cyws.pairs import TwoViews, judged_pairs
from baselines.cyws.presets import PRESETS, Dimension, Preset
from baselines.cyws.registration import Registration
from baselines.cyws.scenes import SceneFrames, render_scene, write_shard
from baselines.cyws.train import Train
from baselines.cyws.training import TrainConfig, Trainer, box_ap
from baselines.cyws.weights import load_network
from data_tools.synthetic_pairs.scene import PairSpec
from scenediff_classic.errors import InputError

CONFIG = TrainConfig(pairs=8, batch=2, validate_every=4)
SPEC = PairSpec("x", 9, frames=2, width=96, height=64, close=True, texture_size=256)


@pytest.fixture(scope="module")
def scenes() -> list[SceneFrames]:
    return [render_scene(SPEC)]


def _tiny(model: Dimension) -> Preset:
    return replace(PRESETS["cyws2d-small" if model == "2d" else "cyws3d-small"], channels=8)


@pytest.mark.parametrize("model", ["2d", "3d"])
def test_stopped_and_resumed_is_as_in_one_go(
    model: Dimension, scenes: list[SceneFrames], tmp_path: Path
) -> None:
    pairs = judged_pairs(scenes, 2)
    whole = Trainer(model, _tiny(model), CONFIG, tmp_path / "whole")
    whole.run(scenes, pairs)
    Trainer(model, _tiny(model), CONFIG, tmp_path / "cut").run(scenes, pairs, until=2)
    resumed = Trainer(model, _tiny(model), CONFIG, tmp_path / "cut")
    assert resumed.step == 2
    resumed.run(scenes, pairs)
    for name, value in whole.network.state_dict().items():
        assert torch.equal(value, resumed.network.state_dict()[name]), name
    assert [p.loss for p in whole.curve] == [p.loss for p in resumed.curve]
    other = Trainer(model, _tiny(model), replace(CONFIG, seed=1), tmp_path / "other")
    other.run(scenes, pairs, until=1)
    with pytest.raises(InputError, match="other options"):
        Trainer(model, _tiny(model), replace(CONFIG, rate=1e-4), tmp_path / "cut")


def test_the_loss_falls(scenes: list[SceneFrames], tmp_path: Path) -> None:
    config = TrainConfig(pairs=120, batch=4, validate_every=40, rate=4e-3)
    trainer = Trainer("3d", _tiny("3d"), config, tmp_path)
    trainer.run(scenes, judged_pairs(scenes, 2))
    assert trainer.curve[-1].loss < 0.6 * trainer.curve[0].loss


def test_the_order_of_pairs_does_not_matter(scenes: list[SceneFrames]) -> None:
    torch.manual_seed(0)
    network, pairs = _tiny("3d").build(), judged_pairs(scenes, 4)
    assert len(pairs) == 4
    straight, turned = judge(network, pairs, 4), judge(network, pairs[::-1], 3)
    assert straight.ap50 == pytest.approx(turned.ap50, abs=1e-9)
    assert straight.boxes == turned.boxes > 0
    assert straight.ap50 == pytest.approx(box_ap(network, pairs, 2), abs=1e-9)


class _SevenWide(torch.nn.Module):
    """Boxes 7 x 7 pixels around (20, 20) in both pictures of 64 x 64, and nothing else."""

    def forward(self, images: torch.Tensor, registration: Registration) -> HeadMaps:
        heat = torch.full((2, 1, 64, 64), -1e4)
        heat[:, 0, 20, 20] = 2.0
        return HeadMaps(heat, torch.full((2, 2, 64, 64), 7.0), torch.zeros(2, 2, 64, 64))


def test_both_conventions_of_boxes() -> None:
    pair = TwoViews(
        np.zeros((2, 64, 64, 3), np.uint8), np.ones((2, 64, 64), np.float32),
        np.stack([np.eye(3)] * 2), np.stack([np.eye(4)] * 2),
        np.array([[[15, 15, 25, 25]] * 2], np.float32),
    )  # fmt: skip
    # 49 of 100 square pixels are shared; with a pixel more on every side, 81 of 144
    assert judge(_SevenWide(), [pair]).ap50 == 0
    assert judge(_SevenWide(), [pair]).false_boxes is None  # for want of a pair without change
    assert judge(_SevenWide(), [pair], convention="wide").ap50 == 1


def test_command_line(
    scenes: list[SceneFrames], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for split in ("train", "val", "test"):
        write_shard(tmp_path / split / "00000.npz", scenes)
    monkeypatch.setitem(PRESETS, "cyws3d-small", replace(_tiny("3d"), height=64, width=96))
    Train(tmp_path, tmp_path / "run", options=CONFIG, device="cpu")()
    about = json.loads((tmp_path / "run" / "curve.json").read_text())
    assert [p["pairs"] for p in about["curve"]] == [4, 8]
    assert (tmp_path / "run" / "curve.png").read_bytes().startswith(b"\x89PNG")
    network, _ = load_network(tmp_path / "run" / "model.safetensors")
    assert not network.training
    out = tmp_path / "scores.json"
    weights = tmp_path / "run" / "model.safetensors"
    results = Evaluate(tmp_path, weights_3d=weights, models=("3d",), out=out)()
    assert results["3d, true geometry"].pairs == 4
    assert json.loads(out.read_text())["3d, true geometry"]["pairs"] == 4
    with pytest.raises(InputError, match="--data or --rendered"):
        Evaluate(weights_3d=weights, models=("3d",))()


def test_curve_is_drawn() -> None:
    curve = [CurvePoint(10, 4.0, 0.1, 1.0), CurvePoint(20, 2.0, 0.5, 2.0)]
    picture = draw_curve(curve, "title")
    assert picture.shape == (400, 640, 3)
    blue = (picture == [0x1F, 0x5F, 0xBF]).all(-1)
    assert blue.sum() > 100
    assert np.array_equal(draw_curve([], "empty").shape, picture.shape)
