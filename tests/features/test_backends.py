"""What every feature back-end must hold to: unit vectors that tell surfaces apart."""

from dataclasses import replace
from typing import get_args

import cv2
import numpy as np
import pytest

from scenediff_classic.features.named import FEATURES, FeatureName
from scenediff_classic.protocols import FeatureExtractor
from scenediff_classic.types import View
from tests.plane_scene import BOOK, VASE, render

HEIGHT, WIDTH = 150, 202
WALL = render([], "before", 0, (0, 0, 0), width=WIDTH, height=HEIGHT, focal=180)


@pytest.fixture(params=get_args(FeatureName))
def features(request: pytest.FixtureRequest) -> FeatureExtractor:
    return FEATURES[request.param]


def textured(seed: int, low: int = 60, high: int = 180) -> View:
    """A picture of soft coloured blobs."""
    small = np.random.default_rng(seed).uniform(low, high, (HEIGHT // 8, WIDTH // 8, 3))
    blobs = cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    return replace(WALL, image=np.clip(blobs, 0, 255).astype(np.uint8))


def cosines(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.einsum("ijk,ijk->ij", one, other)


def test_every_name_has_a_back_end():
    assert set(FEATURES) == set(get_args(FeatureName))


def test_protocol(features: FeatureExtractor):
    assert isinstance(features, FeatureExtractor)
    assert 0 < features.similarity < 1 < features.merge < 2


@pytest.mark.parametrize("size", [(150, 202), (97, 64)])
def test_unit_vectors_cover_the_picture(features: FeatureExtractor, size: tuple[int, int]):
    view = render([VASE, BOOK], "before", 0, (0, 0, 0), width=size[1], height=size[0])
    grid = features(view)
    assert grid.shape[:2] == (-(-size[0] // 4), -(-size[1] // 4))
    assert grid.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(grid, axis=-1), 1, atol=1e-4)


def test_cells_describe_the_surface_under_them(features: FeatureExtractor):
    """A picture whose halves are swapped gives swapped features, away from the seams."""
    view = render([], "before", 0, (0, 0, 0), width=200, height=HEIGHT, focal=180)
    view = replace(view, image=textured(1).image[:, :200])
    swapped = replace(view, image=np.roll(view.image, 100, axis=1))
    here, there = features(view), np.roll(features(swapped), -25, axis=1)
    agreement = cosines(here, there)
    assert np.median(np.c_[agreement[:, 8:17], agreement[:, 33:42]]) > 0.97


def test_deterministic(features: FeatureExtractor):
    view = textured(2)
    np.testing.assert_array_equal(features(view), features(view))


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_plain_surfaces_agree_in_spite_of_noise(features: FeatureExtractor, grey: int):
    rng = np.random.default_rng(0)
    noisy = [
        np.clip(grey + rng.normal(0, 2, (HEIGHT, WIDTH, 3)), 0, 255).astype(np.uint8)
        for _ in range(2)
    ]
    exact = np.full((HEIGHT, WIDTH, 3), grey, np.uint8)
    a, b, c = (features(replace(WALL, image=image)) for image in (*noisy, exact))
    assert np.isfinite(c).all()
    assert np.median(cosines(a, b)) > 0.9


def test_small_changes_of_light_are_tolerated(features: FeatureExtractor):
    view = textured(3)
    gains = np.array([1.08, 1.0, 0.95])
    other = replace(view, image=np.clip(view.image * gains * 1.1, 0, 255).astype(np.uint8))
    assert np.median(cosines(features(view), features(other))) > 0.8


def test_other_surfaces_differ(features: FeatureExtractor):
    rng = np.random.default_rng(5)
    view = textured(4)
    noisy = np.clip(view.image + rng.normal(0, 2, view.image.shape), 0, 255).astype(np.uint8)
    stripes = np.full_like(view.image, 100)
    stripes[:, ::6] = stripes[:, 1::6] = (150, 90, 60)
    own, again, other = (
        features(v) for v in (view, replace(view, image=noisy), replace(view, image=stripes))
    )
    same, different = np.median(cosines(own, again)), np.median(cosines(own, other))
    assert same > 0.85
    assert 1 - different > 2 * (1 - same)
    assert different < same - 0.05


def test_unknown_depth_is_no_obstacle(features: FeatureExtractor):
    view = textured(6)
    holes = view.depth.copy()
    holes[40:60, 50:90] = np.nan
    blind = replace(view, depth=np.full_like(view.depth, np.nan))
    partly = replace(view, depth=holes)
    assert np.median(cosines(features(view), features(blind))) > 0.95
    assert np.median(cosines(features(view), features(partly))) > 0.99
