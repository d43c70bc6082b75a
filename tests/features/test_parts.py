"""What is particular to single back-ends and to the steps they share."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.features.cells import cell_centres
from scenediff_classic.features.colours import ColourFeatures
from scenediff_classic.features.combined import CombinedFeatures
from scenediff_classic.features.gradients import GradientFeatures
from scenediff_classic.features.named import FEATURES
from tests.plane_scene import BOOK, VASE, render


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


def test_same_card_from_two_places_agrees_and_others_do_not(views):
    a, b = (FEATURES["gradient-colour"](v) for v in views)
    same = at_card(a, views[0], VASE) @ at_card(b, views[1], VASE)
    other = at_card(a, views[0], VASE) @ at_card(b, views[1], BOOK)
    assert same > 0.9
    assert other < same - 0.2


def test_texture_counts_without_colour():
    flat = render([], "before", 0, (0, 0, 0))
    stripes = np.zeros_like(flat.image) + 100
    stripes[:, ::8] = 180
    mean = np.full_like(stripes, stripes.mean().astype(np.uint8))
    striped, plain = (FEATURES["gradient-colour"](replace(flat, image=i)) for i in (stripes, mean))
    assert np.median(np.einsum("ijk,ijk->ij", striped, plain)) < 0.8


def test_cosines_of_a_combination_are_weighted_means(views):
    parts, weights = (GradientFeatures(), ColourFeatures()), (0.2, 0.8)
    both = CombinedFeatures(parts, weights, similarity=0.9, merge=1.4)

    def cosine(features) -> np.ndarray:
        return np.einsum("ijk,ijk->ij", *(features(v) for v in views))

    expected = sum(w * cosine(p) for p, w in zip(parts, weights, strict=True))
    np.testing.assert_allclose(cosine(both), expected, atol=1e-5)


@pytest.mark.parametrize("weights", [(1.0,), (0.5, 0.6)])
def test_weights_must_fit(weights):
    with pytest.raises(ValueError, match="sum to 1"):
        CombinedFeatures((GradientFeatures(), ColourFeatures()), weights, 0.9, 1.4)


def test_histograms_end_at_depth_edges():
    """Beside a silhouette the background's colours stay out only if depth is respected."""
    wall = render([], "before", 0, (0, 0, 0), width=512, height=384, focal=450)
    image, depth = np.full_like(wall.image, 90), wall.depth.copy()
    image[:, :256], depth[:, :256] = (200, 60, 40), 1.5  # a red card before the grey wall
    bluish = image.copy()
    bluish[:, 256:] = (40, 80, 200)
    changed = {}
    for step in (0.0, 0.1):
        a, b = (
            ColourFeatures(depth_step=step)(replace(wall, image=i, depth=depth))
            for i in (image, bluish)
        )
        changed[step] = 1 - np.einsum("ijk,ijk->ij", a, b)[40, 62]  # 6 pixels inside the card
    assert changed[0.1] < changed[0.0] / 2
    assert changed[0.0] > 0.02


def test_cells_cover_the_picture_evenly():
    np.testing.assert_allclose(cell_centres(8, 4), [2, 6])
    np.testing.assert_allclose(cell_centres(9, 4), [1.5, 4.5, 7.5])
