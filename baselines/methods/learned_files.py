"""The weight files of learned plug-ins."""

from pathlib import Path

from baselines.splat_change.sam_boxes import SamBoxes
from scenediff_classic.features.dino import DinoFeatures
from scenediff_classic.regions.sam import SamRegions


def learned_files(*plug_ins: object) -> tuple[Path, ...]:
    """Those of the plug-ins that are learned."""
    learned = (p for p in plug_ins if isinstance(p, (DinoFeatures, SamBoxes, SamRegions)))
    return tuple(file for plug_in in learned for file in plug_in.files)
