"""Focal lengths from matches, on points seen by known cameras."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scenediff_classic.geometry.registration.focal import USUAL, vote_focal
from scenediff_classic.geometry.registration.sparse_model import EpipolarPair

PIXEL = 1 / 640


def seen_from_around(
    one: float, two: float, seed: int, count: int = 150, cameras: tuple[int, int] = (0, 0)
) -> EpipolarPair:
    """Two pictures of a cloud of points, from places and with turns that a hand would choose."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform([-1, -0.8, 4], [1, 0.8, 6.5], (count, 3))
    turn = Rotation.from_euler(
        "yxz", rng.uniform([0.15, 0.03, -0.1], [0.35, 0.15, 0.1])
    ).as_matrix()
    move = np.array([0, 0, 5.0]) - turn @ np.array([0, 0, 5.0]) + rng.uniform(-0.6, 0.6, 3)
    there = xyz @ turn.T + move
    noise = rng.normal(0, 0.4 * PIXEL, (2, count, 2))
    first = one * xyz[:, :2] / xyz[:, 2:] + noise[0]
    second = two * there[:, :2] / there[:, 2:] + noise[1]
    cross = np.array([[0, -move[2], move[1]], [move[2], 0, -move[0]], [-move[1], move[0], 0]])
    fundamental = np.diag([1 / two, 1 / two, 1]) @ cross @ turn @ np.diag([1 / one, 1 / one, 1])
    return EpipolarPair(cameras, first, second, fundamental / np.linalg.norm(fundamental), PIXEL)


@pytest.mark.parametrize("focal", [0.4, 0.85, 1.5])
def test_many_pairs_tell_the_focal_length(focal: float) -> None:
    pairs = [seen_from_around(focal, focal, seed) for seed in range(6)]
    assert vote_focal(pairs, {}, [0])[0] == pytest.approx(focal, rel=0.1)


def test_a_known_focal_length_is_used_and_kept() -> None:
    pairs = [seen_from_around(0.5, 1.2, seed, cameras=(0, 1)) for seed in range(6)]
    found = vote_focal(pairs, {0: 0.5}, [0, 1])
    assert found == {1: pytest.approx(1.2, rel=0.1)}


def test_captures_may_differ() -> None:
    pairs = [seen_from_around(0.5, 0.5, seed, cameras=(0, 0)) for seed in range(5)]
    pairs += [seen_from_around(1.1, 1.1, seed, cameras=(1, 1)) for seed in range(5, 10)]
    found = vote_focal(pairs, {}, [0, 1])
    assert found[0] == pytest.approx(0.5, rel=0.15)
    assert found[1] == pytest.approx(1.1, rel=0.15)


@pytest.mark.parametrize("pairs", [[], [seen_from_around(0.4, 0.4, 0, count=12)]])
def test_without_evidence_a_usual_camera_is_taken(pairs: list[EpipolarPair]) -> None:
    assert vote_focal(pairs, {}, [0])[0] == pytest.approx(USUAL, rel=0.1)
