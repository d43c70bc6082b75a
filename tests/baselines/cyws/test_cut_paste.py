"""Pasted patches are labelled where both moved copies still show them."""

import numpy as np
import pytest
import torch

from baselines.cyws.attention_targets import attention_loss, correspondences
from baselines.cyws.cut_paste import cut_paste_pair, labels
from baselines.cyws.pairs import batched
from baselines.cyws.registration import affine_2d
from baselines.cyws.scenes import SceneFrames


def _patch() -> np.ndarray:
    mask = np.zeros((40, 60), bool)
    mask[10:20, 20:40] = True
    return mask


def _moved(x: float = 0, y: float = 0, stretch: float = 1) -> np.ndarray:
    return np.array([[stretch, 0, x], [0, stretch, y], [0, 0, 1]])


def test_unmoved_patches_keep_their_box() -> None:
    found = labels([_patch()], _moved(), _moved())
    np.testing.assert_array_equal(found, [[[20, 10, 40, 20]] * 2])


def test_what_one_copy_has_lost_counts_in_neither() -> None:
    # the first copy loses all but the left half; the second is moved down by 5
    found = labels([_patch()], _moved(30), _moved(0, 5))
    np.testing.assert_array_equal(found, [[[50, 10, 60, 20], [20, 15, 30, 25]]])
    assert labels([_patch()], _moved(100), _moved()).shape == (0, 2, 4)


def test_boxes_follow_the_stretch() -> None:
    found = labels([_patch()], _moved(stretch=1.5), _moved())
    np.testing.assert_allclose(found[0, 0], [30, 15, 60, 30], atol=1)


@pytest.fixture
def scene() -> SceneFrames:
    rng = np.random.default_rng(0)
    images = rng.integers(0, 255, (3, 64, 96, 3), dtype=np.uint8)
    return SceneFrames(
        images, np.ones((3, 64, 96), np.float32), np.stack([np.eye(3)] * 3),
        np.stack([np.eye(4)] * 3), np.array([0, 0, 1], np.int8), np.zeros(0, np.int8),
        np.zeros((0, 3, 4), np.float32), np.zeros((0, 3), np.int32),
    )  # fmt: skip


def test_pairs_know_how_they_were_moved(scene: SceneFrames) -> None:
    pair = cut_paste_pair([scene], np.random.default_rng(3), 0.0)
    assert pair.across_2d is not None
    np.testing.assert_allclose(pair.across_2d, np.eye(3)[:2], atol=1e-12)
    moved = [cut_paste_pair([scene], np.random.default_rng(k)) for k in range(12)]
    assert max(len(p.boxes) for p in moved) > 1
    for p in moved:
        assert p.across_2d is not None
        places = (p.boxes[:, :, :2] + p.boxes[:, :, 2:]) / 2 / [96, 64]
        there = batched([p]).registration.carry(0, 0, places[:, 0])
        np.testing.assert_allclose(there, places[:, 1], atol=0.15)  # boxes are axis-aligned
    again = cut_paste_pair([scene], np.random.default_rng(5))
    assert np.array_equal(again.images, moved[5].images)


def test_attention_should_look_at_the_same_place() -> None:
    flat = affine_2d(np.array([[[1, 0, 0.25], [0, 1, 0]]]), 32, 32)  # one cell of four
    cell, same = correspondences(flat, 2, 4)
    assert same.tolist() == [[[True, True, True, False] * 2, [False, True, True, True] * 2]]
    assert cell[0, 0][same[0, 0]].tolist() == [1, 2, 3, 5, 6, 7]
    assert cell[0, 1][same[0, 1]].tolist() == [0, 1, 2, 4, 5, 6]
    right = torch.full((1, 2, 8, 8), -20.0)
    right.scatter_(3, cell[..., None], 20.0)
    assert attention_loss([((2, 4), right)], flat).item() < 1e-6
    even = attention_loss([((2, 4), torch.zeros(1, 2, 8, 8))], flat).item()
    assert even == pytest.approx(np.log(8))
