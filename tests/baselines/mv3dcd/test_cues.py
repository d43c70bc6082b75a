"""Two pictures differ where features and structure both say so."""

from dataclasses import replace

import cv2
import numpy as np

from baselines.mv3dcd.cues import CueConfig, change_mask, feature_cue, structure_cue
from scenediff_classic.features.gradients import GradientFeatures
from tests.baselines.splat_change.scenes import both, iou, silhouette
from tests.plane_scene import VASE

CONFIG = CueConfig()
PUBLISHED = replace(CONFIG, scale=None, channels=(0,))


def test_a_new_thing_differs() -> None:
    bare, full = both([], []), both([], [VASE])
    view, everywhere = full.views[4], np.ones(full.views[4].shape, bool)
    mask = change_mask(view, bare.views[4].image, everywhere, CONFIG)
    assert iou(mask > 0, silhouette(full, 4, 0.85)) > 0.5
    assert 0.5 <= mask[mask > 0].min() <= mask.max() <= 1


def test_equal_pictures_do_not_differ() -> None:
    view = both([VASE], []).views[0]
    everywhere = np.ones(view.shape, bool)
    for config in (CONFIG, PUBLISHED):
        assert not change_mask(view, view.image, everywhere, config).any()


def test_published_cue_peaks_at_one_whatever_the_pictures_are() -> None:
    raw = np.linspace(0, 0.02, 100).reshape(10, 10)
    known = np.ones((10, 10), bool)
    assert feature_cue(raw, known, PUBLISHED).max() == 1
    assert not feature_cue(raw, known, CONFIG).any()
    assert not feature_cue(raw, ~known, PUBLISHED).any()


def test_small_cues_are_zero() -> None:
    config = CueConfig(GradientFeatures(), scale=1.0)
    raw = np.array([[0.2, 0.49, 0.5, 0.8, 3.0]])
    found = feature_cue(raw, np.ones((1, 5), bool), config)
    np.testing.assert_allclose(found, [[0, 0, 0.5, 0.8, 1]], atol=1e-6)


def test_structure_of_one_colour() -> None:
    rng = np.random.default_rng(0)
    first = cv2.GaussianBlur(rng.integers(0, 255, (40, 40, 3), np.uint8), (5, 5), 1.5)
    second = first.copy()
    second[..., 1:] = second[::-1, ::-1, 1:]  # green and blue differ, red does not
    assert structure_cue(first, second, CONFIG).mean() > 0.3
    assert not structure_cue(first, second, PUBLISHED).any()


def test_unknown_pixels_stay_unknown() -> None:
    view = both([], [VASE]).views[4]
    known = np.ones(view.shape, bool)
    known[:, :20] = False
    ignore = np.zeros(view.shape, bool)
    ignore[:10] = True
    other = np.zeros_like(view.image)
    mask = change_mask(replace(view, ignore=ignore), other, known, CONFIG)
    assert np.array_equal(np.isnan(mask), ~known | ignore)
