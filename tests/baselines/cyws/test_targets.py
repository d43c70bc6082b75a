"""Losses as worked out by hand, and boxes that come back from their targets."""

import math

import numpy as np
import pytest
import torch

from baselines.cyws.boxes import decode
from baselines.cyws.decoder import HeadMaps
from baselines.cyws.targets import encode, loss, radius


def _maps(heat: list[float], size: float = 0.0, offset: float = 0.0) -> HeadMaps:
    row = torch.tensor(heat).reshape(1, 1, 1, -1)
    wide = row.shape[-1]
    return HeadMaps(row, torch.full((1, 2, 1, wide), size), torch.full((1, 2, 1, wide), offset))


def test_loss_without_any_object() -> None:
    targets = encode([np.zeros((0, 4), np.float32)], 1, 2, 1)
    # both cells at one half: -(1/2)^2 log(1/2) each, over max(1, 0 objects)
    assert loss(_maps([0.0, 0.0]), targets).item() == pytest.approx(0.5 * math.log(2))


def test_loss_with_an_object() -> None:
    targets = encode([np.array([[0, 0, 1, 1]], np.float32)], 1, 2, 1)
    assert targets.heat.flatten().tolist() == [1, 0]  # radius 0
    p, q = 0.8, 0.3
    maps = _maps([math.log(p / (1 - p)), math.log(q / (1 - q))], size=3.0, offset=0.1)
    focal = -((1 - p) ** 2) * math.log(p) - q**2 * math.log(1 - q)
    want = focal + 0.1 * (2 + 2) / 2 + (0.4 + 0.4) / 2
    assert loss(maps, targets).item() == pytest.approx(want, rel=1e-5)


def test_near_misses_cost_less() -> None:
    box = np.array([[4, 4, 20, 20]], np.float32)
    targets = encode([box], 24, 24, 1)
    around = targets.heat[0, 0, 12, 12:18]
    assert around[0] == 1
    assert bool((around[1:4] < around[:3]).all())
    reach = int(radius(16, 16))
    sigma = (2 * reach + 1) / 6
    assert around[1].item() == pytest.approx(math.exp(-1 / (2 * sigma**2)))


@pytest.mark.parametrize(("width", "height"), [(10, 10), (30, 8), (5, 40)])
def test_radius_keeps_the_overlap(width: float, height: float) -> None:
    r, area = radius(width, height), width * height
    shifted = (width - r) * (height - r) / (2 * area - (width - r) * (height - r))
    shrunk = (width - 2 * r) * (height - 2 * r) / area
    grown = area / ((width + 2 * r) * (height + 2 * r))
    assert min(shifted, shrunk, grown) == pytest.approx(0.3)


def test_boxes_come_back_from_their_targets() -> None:
    first = np.array([[10.5, 4, 30, 20.25], [50, 30, 62, 61]], np.float32)
    pictures = [first, np.zeros((0, 4), np.float32), first[1:]]
    targets = encode(pictures, 32, 40, 2)
    heat = torch.logit(targets.heat.clamp(1e-6, 1 - 1e-6))
    found = decode(HeadMaps(heat, targets.size, targets.offset), 64, 80)
    for boxes, truth in zip(found, pictures, strict=True):
        sure = boxes.xyxy[boxes.score > 0.99]
        want = truth[np.argsort(truth[:, 0])]
        np.testing.assert_allclose(sure[np.argsort(sure[:, 0])], want, atol=1e-4)


def test_no_more_boxes_than_asked_for() -> None:
    heat = torch.randn(1, 1, 40, 40, generator=torch.Generator().manual_seed(0))
    maps = HeadMaps(heat, torch.ones(1, 2, 40, 40), torch.zeros(1, 2, 40, 40))
    (found,) = decode(maps, 40, 40)
    assert len(found.score) == 100
    assert (np.diff(found.score) <= 0).all()
    assert len(decode(maps, 40, 40, top=7)[0].score) == 7
