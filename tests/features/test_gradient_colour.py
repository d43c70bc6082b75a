"""Features are unit vectors that agree on equal surfaces and differ on others."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.features.gradient_colour import GradientColourFeatures, cell_centres
from tests.plane_scene import BOOK, CLOCK, VASE, render


@pytest.fixture(scope="module")
def views():
    return [render([VASE, BOOK], "before", k, (x, 0.0, 0.0)) for k, x in enumerate((-0.1, 0.1))]


def at_card(features: np.ndarray, view, card) -> np.ndarray:
    """Feature in the middle of a card."""
    focal, centre = view.intrinsics[0, 0], view.intrinsics[:2, 2]
    where = np.array([card.x + card.width / 2, card.y + card.height / 2, card.z])
    inside = where + view.cam_from_world[:3, 3]
    x, y = inside[:2] / inside[2] * focal + centre
    rows, columns = features.shape[:2]
    return features[int(y * rows / view.shape[0]), int(x * columns / view.shape[1])]


def test_shape_and_length(views):
    features = GradientColourFeatures(stride=4)(views[0])
    assert features.shape[:2] == (-(-90 // 4), -(-120 // 4))
    np.testing.assert_allclose(np.linalg.norm(features, axis=-1), 1, atol=1e-5)


def test_same_card_from_two_places_agrees_and_others_do_not(views):
    a, b = (GradientColourFeatures()(v) for v in views)
    same = at_card(a, views[0], VASE) @ at_card(b, views[1], VASE)
    other = at_card(a, views[0], VASE) @ at_card(b, views[1], BOOK)
    assert same > 0.9
    assert other < same - 0.2


def test_plain_surfaces_agree_in_spite_of_noise():
    rng = np.random.default_rng(0)
    wall = render([], "before", 0, (0, 0, 0), width=512, height=384, focal=450)
    noisy = [
        replace(wall, image=np.clip(120 + rng.normal(0, 2, (384, 512, 3)), 0, 255).astype(np.uint8))
        for _ in range(2)
    ]
    a, b = (GradientColourFeatures()(v) for v in noisy)
    assert np.einsum("ijk,ijk->ij", a, b).min() > 0.95


def test_texture_counts_without_colour():
    flat = render([], "before", 0, (0, 0, 0))
    stripes = np.zeros_like(flat.image) + 100
    stripes[:, ::8] = 180
    mean = np.full_like(stripes, stripes.mean().astype(np.uint8))
    striped = GradientColourFeatures()(replace(flat, image=stripes))
    plain = GradientColourFeatures()(replace(flat, image=mean))
    assert np.median(np.einsum("ijk,ijk->ij", striped, plain)) < 0.8


def test_cells_cover_the_picture_evenly():
    np.testing.assert_allclose(cell_centres(8, 4), [2, 6])
    np.testing.assert_allclose(cell_centres(9, 4), [1.5, 4.5, 7.5])


def test_deterministic():
    view = render([CLOCK], "after", 0, (0, 0, 0))
    np.testing.assert_array_equal(GradientColourFeatures()(view), GradientColourFeatures()(view))
