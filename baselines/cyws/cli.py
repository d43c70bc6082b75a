"""``scenediff-cyws3d`` and ``scenediff-cyws2d``: the baselines with the inputs and the output of
``scenediff-classic detect``."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from baselines.cyws.detector import CywsConfig, detect_with_cyws
from baselines.cyws.presets import Dimension
from baselines.cyws.weights import load_network
from scenediff_classic.detection_run import CaptureOptions, run_detection
from scenediff_classic.devices import Device
from scenediff_classic.presets import Preset, configured
from scenediff_classic.regions.named import RegionName
from scenediff_classic.terminal import print_outcome, progress_bars, run_command


@dataclass(frozen=True)
class Detect:
    """Find what was added or removed between two captures of a place, by a CYWS network.

    Each capture is a video file, a folder of photos, or one photo.
    """

    before: tyro.conf.Positional[Path]
    """The earlier capture."""
    after: tyro.conf.Positional[Path]
    """The later capture."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the result; made anew. A killed run with the same call continues."""
    weights: Path | None = None
    """A published checkpoint or another one of yours; left out: the small one trained here."""
    geometry: Path | None = None
    """Known cameras and depth, such as the output folder of scenediff-classic detect."""
    preset: Preset = "balanced"
    """Of the geometry: trade-off between time and detail."""
    regions: RegionName = "boundary-merging"
    """What turns boxes into masks."""
    fps: float = 1.0
    """Frames per second taken of a video."""
    least: float = 0.3
    """Score below which boxes are dropped."""
    device: Device = "auto"
    """Where the network computes: auto is cuda if PyTorch finds a CUDA device, otherwise cpu."""
    seed: int = 0
    overwrite: bool = False
    """Replace the result of another run in the output folder."""

    def run(self, model: Dimension) -> None:
        """Detect, write the folder, say what was found."""
        base = configured(
            self.preset, seed=self.seed, geometry=self.geometry, device=self.device,
            regions=self.regions,
        )  # fmt: skip
        config = CywsConfig(
            model, self.weights, base.geometry, base.regions, self.least, device=self.device
        )
        load_network(config.file)  # refuses what cannot be loaded before any work is done
        known = () if self.geometry is None else (self.geometry,)
        with progress_bars() as progress:
            result = run_detection(
                CaptureOptions(self.before, self.fps),
                CaptureOptions(self.after, self.fps),
                self.out,
                lambda before, after, workspace, progress: detect_with_cyws(
                    before, after, config, workspace=workspace, progress=progress
                ),
                config,
                seed=self.seed,
                overwrite=self.overwrite,
                uses=(*known, config.file),
                command=tuple(sys.argv),
                progress=progress,
            )
        print_outcome(result, self.out)


def main(model: Dimension, arguments: list[str] | None = None) -> int:
    """Run the command; exit codes as of `run_command`."""
    return run_command(
        lambda: tyro.cli(Detect, args=arguments, prog=f"scenediff-cyws{model}").run(model)
    )


def main_2d() -> int:
    """Entry point of ``scenediff-cyws2d``."""
    return main("2d")


def main_3d() -> int:
    """Entry point of ``scenediff-cyws3d``."""
    return main("3d")


if __name__ == "__main__":
    dimension, *rest = sys.argv[1:] or [""]
    if dimension not in ("2d", "3d"):
        sys.exit("Say which: python -m baselines.cyws.cli 2d|3d BEFORE AFTER -o OUT")
    sys.exit(main("2d" if dimension == "2d" else "3d", rest))
