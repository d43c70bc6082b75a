"""Masks of single views become one channel, by optimisation or in closed form."""

from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.gaussian_splatting.losses import Target
from baselines.gaussian_splatting.train import TrainConfig
from baselines.mv3dcd.channel import FusionConfig, LossName, Mode, fused, self_adjusting
from baselines.mv3dcd.cues import CueConfig
from baselines.mv3dcd.detector import (
    Mv3dcdConfig,
    positive_regions,
    published,
    symmetric_mask,
)
from baselines.splat_change.models import ModelConfig
from scenediff_classic.types import Regions
from tests.baselines.splat_change.scenes import both, iou, silhouette, untrained
from tests.plane_scene import BOOK, VASE

MODELS = ModelConfig(120, 20_000, 1, TrainConfig(degree=0, densify=None))
CONFIG = Mv3dcdConfig()


def _fused(before, after, folder: Path, **options):
    geometry = both(before, after)
    config = FusionConfig(**{"update": 40, "iterations": 30, "augmented": 10, **options})
    found = fused(
        untrained(geometry, "before"), geometry, [0, 1, 2], [3, 4, 5], CueConfig(), config,
        MODELS, folder,
    )  # fmt: skip
    return geometry, found


@pytest.mark.parametrize(
    ("mode", "loss"),
    [("optimised", "photometric"), ("optimised", "self-adjusting"), ("closed-form", "photometric")],
)
def test_the_new_thing_lights_up(mode: Mode, loss: LossName, tmp_path: Path) -> None:
    geometry, found = _fused([], [VASE], tmp_path, mode=mode, loss=loss)
    assert sorted(found.change) == [3, 4, 5]
    for k, change in found.change.items():
        truth = silhouette(geometry, k, 0.85)
        assert np.nanmean(change[truth]) > 3 * np.nanmean(change[~truth])
        assert np.nanmax(change) <= 1 + 1e-5
        if loss == "photometric":
            assert iou(np.nan_to_num(change) > 0.4, truth) > 0.4


def test_nothing_lights_up_between_equal_captures(tmp_path: Path) -> None:
    _, found = _fused([VASE], [VASE], tmp_path)
    for change in found.change.values():
        assert (np.nan_to_num(change) > 0.5).mean() < 0.005


def test_without_augmentation(tmp_path: Path) -> None:
    _, found = _fused([], [VASE], tmp_path, mode="closed-form", augmented=0)
    assert max(np.nanmax(c) for c in found.change.values()) > 0.5


def test_self_adjusting_loss() -> None:
    target = Target.of(torch.tensor([[[1.0, 0.0], [1.0, 1.0]]]))
    drawn = torch.tensor([[[0.5, 0.5], [1.0, 1.0]]])
    expected = 0.5 / 4 + np.log(1 + 0.75**2)
    assert self_adjusting(drawn, target).item() == pytest.approx(expected)
    hidden = Target.of(target.planes, np.array([[True, True], [False, False]]))
    assert self_adjusting(drawn, hidden).item() == pytest.approx(np.log(1 + 0.5**2))


def test_regions_are_positive_by_their_share() -> None:
    geometry = both([], [VASE, BOOK])
    view = geometry.views[4]
    labels = np.full(view.shape, -1, np.int32)
    labels[10:20, 10:20], labels[30:40, 10:20], labels[50:60, 10:20] = 0, 1, 2
    change = np.zeros(view.shape, np.float32)
    change[10:17, 10:20] = 0.9  # 70 %
    change[30:36, 10:20] = 0.9  # 60 %: not more than 60
    change[50:60, 10:20] = np.nan  # unknown
    regions = Regions(labels, 3)
    (one,) = positive_regions(4, view, regions, change, CONFIG.cues.features, CONFIG)
    assert np.array_equal(one.mask, labels == 0)
    assert one.score == pytest.approx(0.63, abs=1e-3)
    assert one.view == 4
    assert np.linalg.norm(one.descriptor) == pytest.approx(1, abs=1e-3)
    nothing = np.zeros(view.shape, np.float32)
    assert positive_regions(4, view, regions, nothing, CONFIG.cues.features, CONFIG) == []


def test_symmetric_masks() -> None:
    assert symmetric_mask(np.array([[0.4, 0.6, np.nan]]), 0.5).tolist() == [[False, True, False]]


def test_published_options() -> None:
    old = published(CONFIG)
    assert old.cues.scale is None
    assert old.cues.channels == (0,)
    assert old.fusion == CONFIG.fusion
