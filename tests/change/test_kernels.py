"""The compiled feature comparison against the same thing spelled out in NumPy."""

import numpy as np
import pytest

from scenediff_classic.cameras import sample
from scenediff_classic.change.kernels import best_cosine


def best_cosine_in_numpy(own, other, x, y, reach):
    best = np.full(own.shape[:2], np.nan, np.float32)
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            there = sample(other, np.stack([x + dx, y + dy], axis=-1))
            cosine = np.einsum("ijk,ijk->ij", own, there)
            best = np.fmax(best, cosine / np.maximum(np.linalg.norm(there, axis=-1), 1e-6))
    return best


@pytest.mark.parametrize("reach", [0, 1, 2])
def test_agrees_with_numpy(reach):
    rng = np.random.default_rng(reach)
    own = rng.normal(size=(6, 7, 5)).astype(np.float32)
    own /= np.linalg.norm(own, axis=-1, keepdims=True)
    other = rng.normal(size=(8, 5, 5)).astype(np.float32)
    x = rng.uniform(-3, 8, (6, 7)).astype(np.float32)
    y = rng.uniform(-3, 11, (6, 7)).astype(np.float32)
    x[0, 0], y[1, 1], x[2, 2] = np.nan, np.nan, np.inf
    expected = best_cosine_in_numpy(own, other, x, y, reach)
    assert np.isnan(expected).any()
    np.testing.assert_allclose(best_cosine(own, other, x, y, reach), expected, atol=2e-6)


def test_identical_grids_match_exactly():
    rng = np.random.default_rng(0)
    grid = rng.normal(size=(4, 6, 9)).astype(np.float32)
    grid /= np.linalg.norm(grid, axis=-1, keepdims=True)
    x, y = np.meshgrid(np.arange(6) + 0.5, np.arange(4) + 0.5)
    found = best_cosine(grid, grid, x.astype(np.float32), y.astype(np.float32), 0)
    np.testing.assert_allclose(found, 1, atol=1e-6)
