"""``scenediff-3dgs-cd BEFORE AFTER -o OUT``."""

import sys
from dataclasses import dataclass, replace

import tyro

from baselines.splat_change.command import DetectCommand
from baselines.splat_change.sam_boxes import SamBoxes
from baselines.threedgs_cd.detector import ThreedgsCdConfig, detect_with_3dgs_cd, published
from baselines.threedgs_cd.occupancy import OccupancyConfig
from scenediff_classic.terminal import run_command


@dataclass(frozen=True)
class Detect(DetectCommand):
    """Find what was added, removed or moved, by 3DGS-CD.

    Each capture is a video file, a folder of photos, or one photo.
    """

    learned_segmenter: str | None = None
    """Boxes go to a SAM or SAM 2 model instead of GrabCut: the same."""
    occupancy_grid: bool = False
    """Cut each thing out of a grid of voxels, and report the grid's outline in all views."""
    as_published: bool = False
    """With the known faults of the published code (see docs/baselines.md)."""

    @property
    def config(self) -> ThreedgsCdConfig:
        """The detector's options."""
        base = ThreedgsCdConfig()
        differences = base.search.differences
        features = self.extractor(differences.features)
        differences = replace(differences, features=features)
        if self.learned_segmenter is not None:
            differences = replace(differences, segmenter=SamBoxes(self.learned_segmenter))
        config = ThreedgsCdConfig(
            geometry=self.known_geometry,
            models=self.models,
            search=replace(base.search, differences=differences),
            occupancy=OccupancyConfig() if self.occupancy_grid else None,
        )
        return published(config) if self.as_published else config

    def __call__(self) -> None:
        """Run the detection and say what was found."""
        config = self.config
        self.detected(
            lambda before, after, workspace, progress: detect_with_3dgs_cd(
                before, after, config, workspace=workspace, progress=progress,
                pictures=self.pictures,
            ),
            config,
            config.search.differences.features,
            config.search.differences.segmenter,
        )  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Entry point of ``scenediff-3dgs-cd``."""
    return run_command(tyro.cli(Detect, args=arguments, prog="scenediff-3dgs-cd"))


if __name__ == "__main__":
    sys.exit(main())
