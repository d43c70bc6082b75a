"""Presets: what they set, and which numbers are refused before any work is done."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest

from scenediff_classic import presets
from scenediff_classic.change.scoring import ScoringConfig
from scenediff_classic.change.threshold import ThresholdConfig
from scenediff_classic.change.visibility import VisibilityConfig
from scenediff_classic.errors import InputError
from scenediff_classic.features.named import FEATURES, FeatureName
from scenediff_classic.geometry.from_pictures import GeometryFromPictures
from scenediff_classic.geometry.known_cameras import KnownGeometry
from scenediff_classic.geometry.stereo.patchmatch import PatchMatch
from scenediff_classic.geometry.stereo.plane_sweep import PlaneSweep
from scenediff_classic.pipeline import DetectConfig
from scenediff_classic.presets import (
    LONG_SIDE,
    MIN_LONG_SIDE,
    Preset,
    configured,
    weight_files,
)
from scenediff_classic.regions.named import REGIONS, RegionName


def from_pictures(config: DetectConfig) -> GeometryFromPictures:
    assert isinstance(config.geometry, GeometryFromPictures)
    return config.geometry


def test_every_preset_has_a_size_and_they_rise() -> None:
    sizes = [LONG_SIDE[preset] for preset in get_args(Preset)]
    assert sizes == sorted(set(sizes))
    for preset in get_args(Preset):
        assert from_pictures(configured(preset)).registration.long_side == LONG_SIDE[preset]


def test_more_time_buys_more_sources() -> None:
    sources = [from_pictures(configured(preset)).stereo.sources for preset in get_args(Preset)]
    assert sources == sorted(set(sources))


def test_a_given_size_counts_more_than_the_preset() -> None:
    assert from_pictures(configured("accurate", long_side=200)).registration.long_side == 200
    known = configured("accurate", long_side=200, geometry=Path("known.npz")).geometry
    assert known == KnownGeometry(Path("known.npz"), long_side=200)


def test_every_stage_that_draws_gets_the_seed() -> None:
    geometry = from_pictures(configured(seed=7))
    assert geometry.completion is not None
    assert geometry.registration.seed == geometry.completion.seed == 7
    assert geometry.stereo.matcher == PatchMatch(seed=7)


def test_stereo_can_be_a_plane_sweep() -> None:
    swept = from_pictures(configured(seed=7, stereo="plane-sweep")).stereo.matcher
    assert swept == PlaneSweep(second=PatchMatch(seed=7, consistent_sweeps=1))


def test_small_pictures_are_swept_and_make_more_noise() -> None:
    fast, balanced = configured("fast"), configured()
    assert isinstance(from_pictures(fast).stereo.matcher, PlaneSweep)
    assert isinstance(from_pictures(balanced).stereo.matcher, PatchMatch)
    by_hand = from_pictures(configured("fast", stereo="patchmatch")).stereo.matcher
    assert isinstance(by_hand, PatchMatch)
    assert (fast.threshold.noise_floor or 0) > (balanced.threshold.noise_floor or 0) > 0
    own = DetectConfig(threshold=ThresholdConfig(noise_floor=0.05))
    assert configured("fast", base=own).threshold.noise_floor == 0.05


def test_only_the_accurate_preset_trusts_half_of_a_region() -> None:
    shares = [configured(p).scoring.measured_share for p in ("fast", "balanced", "accurate")]
    assert shares == [1.0, 1.0, 0.5]
    own = DetectConfig(scoring=ScoringConfig(measured_share=0.8))
    assert configured("accurate", base=own).scoring.measured_share == 0.8


def test_matching_with_weights_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(presets, "check_learned", lambda folder: None)
    config = configured(learned_matching=tmp_path)
    assert from_pictures(config).registration.learned == tmp_path
    assert [file.parent for file in weight_files(config)] == [tmp_path, tmp_path]
    assert weight_files(configured()) == ()


@pytest.mark.parametrize("name", get_args(FeatureName))
def test_features_by_name_with_known_geometry_too(name: FeatureName) -> None:
    assert configured(features=name).features == FEATURES[name]
    known = configured(features=name, geometry=Path("known.npz"))
    assert known.features == FEATURES[name]
    assert configured().features == FEATURES["gradient-colour"]


def test_every_region_method_has_a_proposer() -> None:
    assert tuple(REGIONS) == get_args(RegionName)
    assert REGIONS["boundary-merging"] == DetectConfig().regions
    assert configured(regions="things-on-supports").regions == REGIONS["things-on-supports"]


def test_options_of_later_stages_are_kept() -> None:
    base = DetectConfig(threshold=ThresholdConfig(fixed=0.4))
    assert configured("fast", base=base).threshold.fixed == 0.4


@pytest.mark.parametrize("seed", [-1, 2**31])
def test_seeds_out_of_range(seed: int) -> None:
    with pytest.raises(InputError, match="seed"):
        configured(seed=seed)


def test_sizes_out_of_range() -> None:
    assert configured(long_side=MIN_LONG_SIDE)
    with pytest.raises(InputError, match="long side"):
        configured(long_side=MIN_LONG_SIDE - 1)


@pytest.mark.parametrize(
    "scoring",
    [
        ScoringConfig(voxel=0.0),
        ScoringConfig(geometry_noise=0.0),
        ScoringConfig(geometry_scale=0.0),
        ScoringConfig(region_weight=-0.1),
        ScoringConfig(feature_weight=float("inf")),
        ScoringConfig(visibility=VisibilityConfig(depth_edge=float("nan"))),
    ],
)
def test_numbers_without_a_meaning(scoring: ScoringConfig) -> None:
    with pytest.raises(InputError, match=r"^scoring\."):
        configured(base=DetectConfig(scoring=scoring))


def test_a_weight_of_zero_and_a_negative_occlusion_margin_have_a_meaning() -> None:
    visibility = replace(VisibilityConfig(), occlusion=-0.05)
    scoring = ScoringConfig(region_weight=0.0, visibility=visibility, measured_share=1.0)
    assert configured(base=DetectConfig(scoring=scoring)).scoring == scoring
