"""How sure stereo is of a depth."""

import numpy as np

from scenediff_classic.geometry.stereo.depth_confidence import depth_confidence, roughness
from scenediff_classic.geometry.stereo.patchmatch import PatchMatch

WEIGHTS = PatchMatch.confidence_weights


def plane(height: int = 12, width: int = 16) -> np.ndarray:
    """Depth of a slanted plane: inverse depth is linear over the picture."""
    y, x = np.mgrid[0:height, 0:width]
    return (1 / (0.5 + 0.01 * x + 0.005 * y)).astype(np.float32)


def test_planes_are_smooth_however_slanted_and_steps_are_rough() -> None:
    depth = plane()
    assert roughness(depth).max() < 0.1  # rounding of float32
    np.testing.assert_allclose(roughness(depth * 10), roughness(depth), atol=0.1)
    depth[:, 8:] *= 1.5
    np.testing.assert_allclose(roughness(depth)[:, 7:9], 3, rtol=1e-6)
    assert roughness(depth)[:, 10:].max() < 0.1
    # the step is two of a neighbourhood's five columns
    np.testing.assert_allclose(roughness(depth, 5)[:, 7:9], 3 * 2 / 5, atol=0.05)
    assert roughness(depth, 5)[:, 11:].max() < 0.1


def test_more_support_and_better_matches_are_surer() -> None:
    depth = plane()
    none, some = np.zeros(depth.shape, np.int32), np.full(depth.shape, 2, np.int32)
    good, poor = np.full_like(depth, 0.1), np.full_like(depth, 0.9)
    sure = depth_confidence(WEIGHTS, depth, good, some)
    assert np.all(sure > depth_confidence(WEIGHTS, depth, poor, some))
    assert np.all(sure > depth_confidence(WEIGHTS, depth, good, none))
    assert sure.min() > 0.9
    bumpy = depth * np.where(np.indices(depth.shape).sum(0) % 2, 1.01, 0.99).astype(np.float32)
    inner = np.s_[1:-1, 1:-1]
    assert np.all(sure[inner] > depth_confidence(WEIGHTS, bumpy, good, some)[inner])


def test_no_depth_no_confidence_and_no_harm_beside_it() -> None:
    depth = plane()
    depth[4, 5] = np.nan
    cost = np.full_like(depth, 0.1)
    found = depth_confidence(WEIGHTS, depth, cost, np.full(depth.shape, 3, np.int32))
    assert found[4, 5] == 0
    assert np.delete(found.ravel(), 4 * 16 + 5).min() > 0.9
