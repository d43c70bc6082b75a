"""``scenediff-mv3dcd BEFORE AFTER -o OUT``."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from baselines.mv3dcd.channel import FusionConfig, LossName, Mode
from baselines.mv3dcd.detector import Mv3dcdConfig, detect_with_mv3dcd, published
from baselines.splat_change.command import DetectCommand
from scenediff_classic.errors import InputError
from scenediff_classic.regions.named import REGIONS, RegionName
from scenediff_classic.terminal import run_command


@dataclass(frozen=True)
class Detect(DetectCommand):
    """Find what was added, removed or moved, by MV3DCD.

    Each capture is a video file, a folder of photos, or one photo.
    """

    regions: RegionName = "boundary-merging"
    """What tells which capture has the thing that differs."""
    channel: Mode = "optimised"
    """How change masks are fused: optimised, or their mean in closed form (quicker)."""
    loss: LossName = "photometric"
    """Of the optimised channel."""
    update_iterations: int = FusionConfig.update
    """In which each model learns the other capture's pictures."""
    channel_iterations: int = FusionConfig.iterations
    """Of the channel on masks of captured pictures."""
    augmented_iterations: int = FusionConfig.augmented
    """Further ones on masks of renders at all cameras; 0 = none."""
    symmetric: Path | None = None
    """Folder for masks (PNG) of all that differs in each view, whichever capture has it, as
    PASLCD-style evaluation wants them."""
    as_published: bool = False
    """With the known faults of the published code (see docs/baselines.md)."""

    @property
    def config(self) -> Mv3dcdConfig:
        """The detector's options.

        Raises
        ------
        InputError
            If a number is out of range.
        """
        if (
            min(self.update_iterations, self.channel_iterations) < 1
            or self.augmented_iterations < 0
        ):
            raise InputError("Iterations must be at least 1; augmented ones at least 0.")
        base = Mv3dcdConfig()
        fusion = FusionConfig(
            self.channel, self.loss, self.update_iterations, self.channel_iterations,
            self.augmented_iterations, self.seed,
        )  # fmt: skip
        config = replace(
            base,
            geometry=self.known_geometry,
            models=self.models,
            cues=replace(base.cues, features=self.extractor(base.cues.features)),
            fusion=fusion,
            regions=REGIONS[self.regions],
        )
        return published(config) if self.as_published else config

    def __call__(self) -> None:
        """Run the detection and say what was found."""
        config = self.config
        self.detected(
            lambda before, after, workspace, progress: detect_with_mv3dcd(
                before, after, config, workspace=workspace, progress=progress,
                pictures=self.pictures, symmetric=self.symmetric,
            ),
            config,
            config.cues.features,
        )  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Entry point of ``scenediff-mv3dcd``."""
    return run_command(tyro.cli(Detect, args=arguments, prog="scenediff-mv3dcd"))


if __name__ == "__main__":
    sys.exit(main())
