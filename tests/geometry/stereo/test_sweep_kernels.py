"""The compiled kernels of the plane sweep against their NumPy twins."""

import numpy as np
import pytest

from scenediff_classic.geometry.stereo import sweep_kernels as kernels
from scenediff_classic.geometry.stereo import sweep_kernels_reference as reference
from scenediff_classic.geometry.stereo.plane_sweep import DIRECTIONS, with_slopes


def random_volume(seed: int, shape: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Matching costs and a picture with an unknown pixel."""
    rng = np.random.default_rng(seed)
    grey = rng.uniform(0, 1, shape[:2]).astype(np.float32)
    grey[1, 2] = np.nan
    return rng.integers(0, 256, shape).astype(np.uint8), grey


def test_unlikeness_equals_the_twin() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0, 1, (2, 200, 9, 11)).astype(np.float32)
    looks, warped = (np.stack([x.mean(0), x.var(0)]) for x in (a, b))
    warped[1, 2, 3] = 0  # no texture
    product = (a * b).mean(0)
    product[4] += 0.05  # alike in part
    known = np.ones((9, 11), np.uint8)
    known[5, 5] = 0
    costs = np.empty((9, 11), np.uint8)
    kernels.unlikeness(looks, warped, product, known, np.float32(0.9), costs)
    expected = reference.unlikeness(looks, warped, product, known, np.float32(0.9))
    assert np.abs(costs.astype(int) - expected).max() <= 1  # rounding
    assert costs[2, 3] == costs[5, 5] == kernels.WORST
    assert costs[4].max() < kernels.WORST


@pytest.mark.parametrize("best", [1, 2, 5])
def test_mean_of_best_equals_the_twin(best: int) -> None:
    costs = np.random.default_rng(best).integers(0, 256, (4, 6, 7)).astype(np.uint8)
    means = np.empty((6, 7), np.uint8)
    kernels.mean_of_best(costs, best, means)
    np.testing.assert_array_equal(means, reference.mean_of_best(costs, best))


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("shape", [(6, 9, 5), (9, 6, 3), (3, 3, 1)])
def test_scan_equals_the_twin(direction: tuple[int, int], shape: tuple[int, int, int]) -> None:
    volume, grey = random_volume(3, shape)
    totals = np.zeros(shape, np.uint16)
    kernels.scan(volume, grey, *direction, 20, 90, np.float32(0.1), totals)
    expected = reference.scan(volume, grey, *direction, 20, 90, np.float32(0.1))
    # The jump is rounded to a whole number, which may go either way.
    assert np.abs(totals.astype(int) - expected).max() <= 2


def test_a_path_keeps_its_plane_through_a_gap() -> None:
    """Without matches of its own, a pixel takes the plane of the pixels before it."""
    volume = np.full((1, 8, 6), 200, np.uint8)
    volume[0, :4, 2] = 0
    volume[0, 4:] = 100
    totals = np.zeros(volume.shape, np.uint16)
    kernels.scan(volume, np.zeros((1, 8), np.float32), 0, 1, 20, 90, np.float32(0.1), totals)
    assert np.all(np.argmin(totals, axis=2) == 2)
    assert totals[0, 4].tolist() == [190, 120, 100, 120, 190, 190]  # nothing, a step, a jump
    assert totals[0, 7].tolist() == [140, 120, 100, 120, 140, 160]  # many steps, one a pixel


def test_winners_equal_the_twin() -> None:
    volume, _ = random_volume(5, (7, 8, 6))
    totals = volume.astype(np.uint16) * 8
    numbers, costs = np.empty((7, 8), np.float32), np.empty((7, 8), np.float32)
    kernels.winners(totals, volume, numbers, costs)
    expected = reference.winners(totals, volume)
    np.testing.assert_allclose(numbers, expected[0], rtol=1e-6)
    np.testing.assert_allclose(costs, expected[1], rtol=1e-6)


def test_the_parabola_finds_its_lowest_point() -> None:
    totals = np.rint(10 * (np.arange(6) - 2.3) ** 2 + 5).astype(np.uint16).reshape(1, 1, 6)
    numbers, costs = np.empty((1, 1), np.float32), np.empty((1, 1), np.float32)
    kernels.winners(totals, np.full((1, 1, 6), 51, np.uint8), numbers, costs)
    assert numbers[0, 0] == pytest.approx(2.3, abs=0.05)
    assert costs[0, 0] == pytest.approx(0.2)


def test_slopes_of_a_plane() -> None:
    y, x = np.mgrid[:5, :8].astype(np.float32)
    planes = with_slopes(1 + 0.02 * x - 0.01 * y)
    np.testing.assert_allclose(planes[..., 0], 1 + 0.02 * x - 0.01 * y, rtol=1e-6)
    np.testing.assert_allclose(planes[..., 1], 0.02, atol=1e-5)
    np.testing.assert_allclose(planes[..., 2], -0.01, atol=1e-5)
