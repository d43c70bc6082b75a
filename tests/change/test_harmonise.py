"""Gains between views are found from the scene and taken out."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.change.harmonise import (
    ColourPairs,
    HarmoniseConfig,
    fit_gains,
    harmonised,
    light_difference,
)
from scenediff_classic.change.scale import normalised
from scenediff_classic.change.visibility import VisibilityConfig, pair_views
from scenediff_classic.types import Video
from tests.plane_scene import BOOK, VASE, scene


def test_known_gains_are_recovered_in_spite_of_changes():
    rng = np.random.default_rng(0)
    truth = np.log([[1.0, 1.0, 1.0], [0.8, 1.1, 1.0], [1.3, 0.9, 0.7]])
    samples = []
    for i, j in ((0, 1), (1, 2), (0, 2)):
        ratio = truth[i] - truth[j] + rng.normal(0, 0.02, (300, 3))
        ratio[:60] += rng.normal(0.8, 0.3, (60, 3))  # a fifth of the surfaces changed
        samples.append(ColourPairs(i, j, ratio))
    found = fit_gains(samples, 3, HarmoniseConfig())
    relative = found - found[0]
    np.testing.assert_allclose(relative, truth - truth[0], atol=0.03)


def test_a_darker_capture_is_brought_to_the_same_exposure():
    geometry = normalised(scene([VASE, BOOK], [VASE]))
    tint = np.array([0.7, 0.8, 0.9])
    views = tuple(
        replace(v, image=(v.image * tint).astype(np.uint8)) if v.video == "after" else v
        for v in geometry.views
    )
    pairs = pair_views(geometry, VisibilityConfig())
    out = harmonised(replace(geometry, views=views), pairs, HarmoniseConfig(), VisibilityConfig())
    assert out.light < 0.03  # a tint is no other light
    wall = [v.image[:20].reshape(-1, 3).mean(axis=0) for v in out.geometry.views]
    assert np.mean(wall[3:], axis=0) == pytest.approx(np.mean(wall[:3], axis=0), rel=0.06)


def test_light_from_another_side_is_told():
    """Half of the surfaces are brighter by a third in the other capture, half darker."""
    rng = np.random.default_rng(0)
    videos: list[Video] = ["before", "before", "after", "after"]
    samples = []
    for i, j in ((0, 1), (2, 3), (0, 2), (1, 3)):
        ratio = rng.normal(0, 0.02, (300, 3))
        ratio[::2] += 0.3 * (videos[i] != videos[j])
        ratio[1::2] -= 0.3 * (videos[i] != videos[j])
        samples.append(ColourPairs(i, j, ratio))
    gains = fit_gains(samples, 4, HarmoniseConfig())
    assert light_difference(samples, gains, videos) == pytest.approx(0.3, abs=0.02)
    assert light_difference(samples[:2], gains, videos) == 0  # nothing between the captures
    assert light_difference(samples[2:], gains, videos) == 0  # single photos


def test_nothing_in_common_changes_nothing():
    geometry = normalised(scene([VASE], [VASE]))
    blind = tuple(replace(v, depth=np.full_like(v.depth, np.nan)) for v in geometry.views)
    out = harmonised(
        replace(geometry, views=blind), ((0, 3),), HarmoniseConfig(), VisibilityConfig()
    )
    for before, after in zip(geometry.views, out.geometry.views, strict=True):
        np.testing.assert_array_equal(before.image, after.image)
