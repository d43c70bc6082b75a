"""Noise must be the same everywhere: textures, and so the published pairs, hang on it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from data_tools.synthetic_pairs import noise


def _scramble(value: int, seed: int) -> int:
    """The mixing of `noise.scramble` in Python's unbounded integers."""
    word = 0xFFFFFFFF
    x = (value + (seed * 0x9E3779B1 & word)) & word
    x = (x ^ (x >> 16)) * 0x7FEB352D & word
    x = (x ^ (x >> 15)) * 0x846CA68B & word
    return x ^ (x >> 16)


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
def test_scramble_is_exact_integer_arithmetic(value: int, seed: int) -> None:
    assert int(noise.scramble(np.array([value], np.uint32), seed)[0]) == _scramble(value, seed)


def test_uniform_and_bell_have_their_moments() -> None:
    index = np.arange(200_000, dtype=np.uint32)
    flat, bell = noise.uniform(index, 5), noise.bell(index, 6)
    assert flat.min() >= 0
    assert flat.max() < 1
    assert flat.mean() == pytest.approx(0.5, abs=0.003)
    assert flat.var() == pytest.approx(1 / 12, abs=0.001)
    assert bell.mean() == pytest.approx(0, abs=0.01)
    assert bell.std() == pytest.approx(1, abs=0.01)


def test_neighbours_and_seeds_are_independent() -> None:
    index = np.arange(100_000, dtype=np.uint32)
    here = noise.uniform(index, 1)
    assert abs(np.corrcoef(here[:-1], here[1:])[0, 1]) < 0.02
    assert abs(np.corrcoef(here, noise.uniform(index, 2))[0, 1]) < 0.02


def test_value_noise_interpolates_its_lattice() -> None:
    grid = noise.lattice(4, 4, 9)
    fine = noise.value_noise(4, 4 * 501, 4, 4, 9)
    # One row of pixels for a cell: rows lie midway between lattice rows, where the weight is 1/2.
    midway = 0.5 * (grid[0] + np.roll(grid, -1, axis=0)[0])
    np.testing.assert_allclose(fine[0, 0::501], midway, atol=1e-5)


def test_value_noise_tiles() -> None:
    picture = noise.value_noise(64, 64, 8, 8, 3)
    inside = np.abs(np.diff(picture, axis=1)).max()
    across = np.abs(picture[:, 0] - picture[:, -1]).max()
    assert across <= 1.5 * inside


def test_fbm_is_in_range_and_rougher_with_more_octaves() -> None:
    smooth = noise.fbm(128, 128, 4, 4, 1, octaves=1)
    rough = noise.fbm(128, 128, 4, 4, 1, octaves=5)
    for picture in (smooth, rough):
        assert picture.min() >= 0
        assert picture.max() < 1
    roughness = [np.abs(np.diff(p)).mean() / p.std() for p in (smooth, rough)]
    assert roughness[1] > 1.5 * roughness[0]


def test_seed_of_depends_on_every_part() -> None:
    seeds = {
        noise.seed_of(1, "a"),
        noise.seed_of(1, "b"),
        noise.seed_of(2, "a"),
        noise.seed_of("a", 1),
    }
    assert len(seeds) == 4
    assert noise.seed_of(1, "a") == 4064362262  # CRC-32 of "1/a"
