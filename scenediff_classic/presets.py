"""Named trade-offs between time and detail."""

import math
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal

from scenediff_classic.errors import InputError
from scenediff_classic.geometry.from_pictures import GeometryFromPictures
from scenediff_classic.geometry.known_cameras import KnownGeometry
from scenediff_classic.geometry.registration.structure_from_motion import StructureFromMotion
from scenediff_classic.geometry.stereo.completion import DepthCompletion
from scenediff_classic.geometry.stereo.depth_map import Matcher
from scenediff_classic.geometry.stereo.devices import Device, check_device
from scenediff_classic.geometry.stereo.multi_view import MultiViewStereo
from scenediff_classic.geometry.stereo.patchmatch import PatchMatch
from scenediff_classic.geometry.stereo.plane_sweep import PlaneSweep
from scenediff_classic.pipeline import DetectConfig
from scenediff_classic.protocols import RegionProposer
from scenediff_classic.regions.boundary_merging import BoundaryMergingRegions
from scenediff_classic.regions.things_on_supports import ThingsOnSupportsRegions

Preset = Literal["fast", "balanced", "accurate"]

StereoMethod = Literal["patchmatch", "plane-sweep"]

RegionMethod = Literal["boundary-merging", "things-on-supports"]

REGIONS: dict[RegionMethod, RegionProposer] = {
    "boundary-merging": BoundaryMergingRegions(),
    "things-on-supports": ThingsOnSupportsRegions(),
}
"""Region proposers by name."""

LONG_SIDE: dict[Preset, int] = {"fast": 320, "balanced": 512, "accurate": 768}
"""Longer side of the pictures that stereo, regions and features work on."""


MIN_LONG_SIDE = 64
"""Below this, neither stereo nor regions have enough pixels to work on."""

_SOURCES: dict[Preset, int] = {"fast": 4, "balanced": 6, "accurate": 8}

_DIVISORS = {"scoring.voxel", "threshold.bins", "objects.max_points"}


def configured(
    preset: Preset = "balanced",
    *,
    long_side: int | None = None,
    seed: int = 0,
    geometry: Path | None = None,
    device: Device = "auto",
    stereo: StereoMethod = "patchmatch",
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
        Where stereo computes.
    stereo : "patchmatch" or "plane-sweep"
        How depth is matched: a plane sweep is quicker and less exact.
    base : DetectConfig
        Options of the later stages.

    Raises
    ------
    InputError
        If a number is out of range, or the device is not there.
    """
    side = LONG_SIDE[preset] if long_side is None else long_side
    if side < MIN_LONG_SIDE:
        raise InputError(f"The long side must be at least {MIN_LONG_SIDE} pixels, not {side}.")
    if not 0 <= seed < 2**31:
        raise InputError(f"The seed must be from 0 to {2**31 - 1}, not {seed}.")
    check_device(device)
    _check_numbers(base, "")
    if geometry is not None:
        return replace(base, geometry=KnownGeometry(geometry, long_side=side))
    planes = PatchMatch(seed=seed, device=device)
    if preset == "accurate":
        planes = replace(planes, sweeps=(6, 4, 4, 3))
    swept = PlaneSweep(second=replace(planes, consistent_sweeps=1))
    matcher: Matcher = swept if stereo == "plane-sweep" else planes
    depth = MultiViewStereo(matcher, sources=_SOURCES[preset])
    sfm = StructureFromMotion(long_side=side, seed=seed)
    completion = DepthCompletion(seed=seed)
    return replace(base, geometry=GeometryFromPictures(sfm, depth, completion))


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
