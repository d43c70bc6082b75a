"""Pictures are laid over each other by any of the modes."""

import numpy as np
import pytest
import torch

from baselines.cyws.registration import (
    Registration,
    affine_2d,
    from_correspondences,
    known_geometry,
    plain_difference,
)
from scenediff_classic.errors import AlignmentError

LENS = np.array([[40.0, 0, 20], [0, 40.0, 15], [0, 0, 1]])


def _pair(shift: float = 0.2, far: float = 2.0) -> Registration:
    """Two cameras beside each other before a wall: 0.2 m at 2 m is 4 pixels."""
    poses = np.stack([np.eye(4), np.eye(4)])[None]
    poses[0, 1, 0, 3] = -shift
    return known_geometry(torch.full((1, 2, 30, 40), far), np.stack([LENS, LENS])[None], poses)


def _pictures(shift: int) -> torch.Tensor:
    wide = torch.from_numpy(np.random.default_rng(0).normal(size=(3, 30, 40 + shift))).float()
    return torch.stack([wide[..., :40], wide[..., shift:]])[None]


def test_the_same_camera_changes_nothing() -> None:
    onto_first, onto_second = _pair(0).splat(30, 40)
    picture = _pictures(0)[:, 0]
    for drawn in (onto_first, onto_second):
        torch.testing.assert_close(drawn.visibility, torch.ones(1, 1, 30, 40))
    flat = torch.full_like(picture, 3.0)
    torch.testing.assert_close(onto_first.draw(flat.flatten(2)), flat)


def test_shifted_pictures_agree_where_both_see() -> None:
    pictures = _pictures(4)
    drawn = _pair().splat(30, 40)[0]
    assert torch.equal(drawn.visibility[0, 0, 15] > 0.9, torch.arange(40) >= 4)
    smooth = torch.nn.functional.avg_pool2d(pictures.flatten(0, 1), 5, 1, 2).unflatten(0, (1, 2))
    registered = _pair().difference(smooth)[0, 0, :, 5:25, 8:36].abs().mean()
    plain = plain_difference(smooth)[0, 0, :, 5:25, 8:36].abs().mean()
    assert registered < 0.5 * plain


def test_carried_there_and_back() -> None:
    uv = np.array([[0.5, 0.5], [0.3, 0.9]])
    across = _pair().carry(0, 0, uv)
    np.testing.assert_allclose(across, uv - [0.1, 0], atol=1e-6)
    np.testing.assert_allclose(_pair().carry(0, 1, across), uv, atol=1e-6)


def test_unknown_depth_has_no_point() -> None:
    holes = _pair()
    holes.depth[0, 1, 10:20, 10:20] = torch.nan
    assert holes.splat(30, 40)[0].visibility[0, 0, 14, 18] == 0
    assert np.isnan(holes.carry(0, 1, np.array([[0.3, 0.5]]))).all()
    assert torch.isfinite(holes.difference(_pictures(4))).all()


def _matches() -> tuple[Registration, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    depth = torch.from_numpy(rng.uniform(1.5, 3, (1, 2, 30, 40))).float()
    true = _pair()
    known = Registration(depth, true.across)
    first = (np.stack([rng.integers(8, 36, 60), rng.integers(2, 28, 60)], 1) + 0.5) / [40, 30]
    second = known.carry(0, 0, first)
    row, column = (second[:, 1] * 30).astype(int), (second[:, 0] * 40).astype(int)
    r, c = (first[:, 1] * 30).astype(int), (first[:, 0] * 40).astype(int)
    inside = (second >= 0).all(1) & (second < 1).all(1)
    depth[0, 1, row[inside], column[inside]] = depth[0, 0, r[inside], c[inside]]
    return known, first[inside], second[inside]


def test_matches_give_the_map_in_spite_of_wrong_ones() -> None:
    known, first, second = _matches()
    second[:8] = np.random.default_rng(4).uniform(0, 1, (8, 2))
    found = from_correspondences(known.depth[0], first, second, seed=1)
    places = np.array([[0.5, 0.5], [0.6, 0.2]])
    np.testing.assert_allclose(found.carry(0, 0, places), known.carry(0, 0, places), atol=0.01)
    again = from_correspondences(known.depth[0], first, second, seed=1)
    assert torch.equal(found.across, again.across)


def test_too_few_matches_are_refused() -> None:
    known, first, second = _matches()
    with pytest.raises(AlignmentError, match="Fewer than five"):
        from_correspondences(known.depth[0], first[:4], second[:4])


def test_a_flat_map_needs_no_depth() -> None:
    flat = affine_2d(np.array([[[1, 0, 0.25], [0, 1, 0]]]), 8, 8)
    np.testing.assert_allclose(flat.carry(0, 0, np.array([[0.2, 0.4]])), [[0.45, 0.4]], atol=1e-6)
    np.testing.assert_allclose(flat.carry(0, 1, np.array([[0.45, 0.4]])), [[0.2, 0.4]], atol=1e-6)


def test_the_published_grid_is_half_a_pixel_off() -> None:
    true = _pair()
    stretched = Registration(true.depth, true.across, stretched=True)
    assert not torch.equal(true.splat(30, 40)[0].weight, stretched.splat(30, 40)[0].weight)
