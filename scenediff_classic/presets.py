"""Named trade-offs between time and detail."""

import math
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal

from scenediff_classic.change.scoring import MEASURED_SHARE
from scenediff_classic.change.threshold import NOISE_FLOOR
from scenediff_classic.devices import Device, check_device
from scenediff_classic.errors import InputError
from scenediff_classic.features.dino import DinoFeatures
from scenediff_classic.features.named import FEATURES, FeatureName
from scenediff_classic.geometry.from_pictures import GeometryFromPictures
from scenediff_classic.geometry.known_cameras import KnownGeometry
from scenediff_classic.geometry.registration.colmap.database import (
    ALIKED_WEIGHTS,
    LIGHTGLUE_WEIGHTS,
    check_learned,
)
from scenediff_classic.geometry.registration.structure_from_motion import StructureFromMotion
from scenediff_classic.geometry.stereo.completion import DepthCompletion
from scenediff_classic.geometry.stereo.depth_map import Matcher
from scenediff_classic.geometry.stereo.multi_view import MultiViewStereo
from scenediff_classic.geometry.stereo.patchmatch import PatchMatch
from scenediff_classic.geometry.stereo.plane_sweep import PlaneSweep
from scenediff_classic.pipeline import DetectConfig
from scenediff_classic.regions.named import REGIONS, RegionName
from scenediff_classic.regions.sam import SamRegions
from scenediff_classic.weights import find_weights

Preset = Literal["fast", "balanced", "accurate"]

StereoMethod = Literal["patchmatch", "plane-sweep"]

LONG_SIDE: dict[Preset, int] = {"fast": 320, "balanced": 512, "accurate": 768}
"""Longer side of the pictures that stereo, regions and features work on."""


MIN_LONG_SIDE = 64
"""Below this, neither stereo nor regions have enough pixels to work on."""

_FLOOR: dict[Preset, float] = {"fast": 0.13, "balanced": NOISE_FLOOR, "accurate": NOISE_FLOOR}
"""Small pictures make more noise: chosen on the rendered `val` pairs."""

_SHARE: dict[Preset, float] = {"fast": MEASURED_SHARE, "balanced": MEASURED_SHARE, "accurate": 0.5}
"""Large pictures show more of small things than stereo can measure; chosen on one real capture."""

STEREO: dict[Preset, StereoMethod] = {
    "fast": "plane-sweep", "balanced": "patchmatch", "accurate": "patchmatch",
}  # fmt: skip
"""The plane sweep is less exact, but in small pictures more changed objects are found with it."""

_SOURCES: dict[Preset, int] = {"fast": 4, "balanced": 6, "accurate": 8}

_DIVISORS = {
    "scoring.voxel", "scoring.geometry_noise", "scoring.geometry_scale", "threshold.bins",
    "objects.max_points", "outlines.most",
}  # fmt: skip


def configured(
    preset: Preset = "balanced",
    *,
    long_side: int | None = None,
    seed: int = 0,
    geometry: Path | None = None,
    device: Device = "auto",
    stereo: StereoMethod | None = None,
    features: FeatureName | None = None,
    regions: RegionName | None = None,
    learned_features: str | None = None,
    learned_regions: str | None = None,
    learned_matching: Path | None = None,
    allow_download: bool = False,
    base: DetectConfig = DetectConfig(),  # noqa: B008 (frozen)
) -> DetectConfig:
    """The options of a preset.

    Parameters
    ----------
    long_side : int, optional
        Overrides the preset's working size, in pixels.
    geometry : Path, optional
        Known geometry to use instead of structure from motion and stereo.
    device : "auto", "cpu" or "cuda"
        Where stereo and learned models compute.
    stereo : "patchmatch" or "plane-sweep", optional
        How depth is matched instead of the preset's own way (`STEREO`).
    features : str, optional
        Name of the feature back-end to use instead of `base`'s (`features.named`).
    regions : str, optional
        Name of the region back-end to use instead of `base`'s (`regions.named`).
    learned_features, learned_regions : str, optional
        Weights of a DINO and of a SAM model (see `weights.find_weights`) for these stages.
    learned_matching : Path, optional
        Folder with the weights of ALIKED and LightGlue, to register with them instead of SIFT.
    allow_download : bool
        Fetch the weights of DINO and SAM from the Hugging Face hub if they are no folders.
    base : DetectConfig
        Options of the later stages.

    Raises
    ------
    InputError
        If a number is out of range, the device is not there, or weights cannot be used.
    """
    side = LONG_SIDE[preset] if long_side is None else long_side
    if side < MIN_LONG_SIDE:
        raise InputError(f"The long side must be at least {MIN_LONG_SIDE} pixels, not {side}.")
    if not 0 <= seed < 2**31:
        raise InputError(f"The seed must be from 0 to {2**31 - 1}, not {seed}.")
    check_device(device)
    _check_numbers(base, "")
    if base.threshold.noise_floor is None:
        base = replace(base, threshold=replace(base.threshold, noise_floor=_FLOOR[preset]))
    if base.scoring.measured_share is None:
        base = replace(base, scoring=replace(base.scoring, measured_share=_SHARE[preset]))
    if features is not None:
        base = replace(base, features=FEATURES[features])
    if regions is not None:
        base = replace(base, regions=REGIONS[regions])
    if learned_features is not None:
        find_weights(learned_features, download=allow_download)
        base = replace(base, features=DinoFeatures(learned_features, device))
    if learned_regions is not None:
        find_weights(learned_regions, download=allow_download)
        base = replace(base, regions=SamRegions(learned_regions, device))
    if learned_matching is not None:
        check_learned(learned_matching)
    weight_files(base)  # refuses what cannot be loaded before any work is done
    if geometry is not None:
        return replace(base, geometry=KnownGeometry(geometry, long_side=side))
    planes = PatchMatch(seed=seed, device=device)
    if preset == "accurate":
        planes = replace(planes, sweeps=(6, 4, 4, 3))
    swept = PlaneSweep(second=replace(planes, consistent_sweeps=1))
    matcher: Matcher = swept if (stereo or STEREO[preset]) == "plane-sweep" else planes
    depth = MultiViewStereo(matcher, sources=_SOURCES[preset])
    sfm = StructureFromMotion(long_side=side, seed=seed, learned=learned_matching)
    completion = DepthCompletion(seed=seed)
    return replace(base, geometry=GeometryFromPictures(sfm, depth, completion))


def weight_files(config: DetectConfig) -> tuple[Path, ...]:
    """The files of learned models: what they hold decides the result."""
    learned = (
        p for p in (config.features, config.regions) if isinstance(p, (DinoFeatures, SamRegions))
    )
    files = tuple(file for plug_in in learned for file in plug_in.files)
    source = config.geometry
    matching = source.registration.learned if isinstance(source, GeometryFromPictures) else None
    if matching is None:
        return files
    return (*files, matching / ALIKED_WEIGHTS, matching / LIGHTGLUE_WEIGHTS)


def _check_numbers(options: Any, prefix: str) -> None:
    """Refuse values without any meaning: not finite, of the wrong sign, or zero as a divisor."""
    for item in fields(options):
        name, value = f"{prefix}{item.name}", getattr(options, item.name)
        if is_dataclass(value):
            _check_numbers(value, f"{name}.")
        elif isinstance(value, (int, float)):
            signed = isinstance(item.default, float) and item.default < 0
            if not math.isfinite(value) or (value < 0 and not signed):
                raise InputError(f"{name} must be a finite number of at least 0, not {value}.")
            if value == 0 and name in _DIVISORS:
                raise InputError(f"{name} must be above 0.")
