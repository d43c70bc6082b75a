"""The command line: arguments and what they call; nothing else lives here."""

import logging
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from rich.logging import RichHandler

from scenediff_classic.change.changed_regions import ObjectConfig
from scenediff_classic.change.moves import MoveConfig
from scenediff_classic.change.outlines import OutlineConfig
from scenediff_classic.change.scoring import ScoringConfig
from scenediff_classic.change.still_there import StillThereConfig
from scenediff_classic.change.threshold import ThresholdConfig
from scenediff_classic.dataset.export import ExportFormat, export
from scenediff_classic.detection_run import CaptureOptions, run_detection
from scenediff_classic.devices import Device
from scenediff_classic.evaluation.benchmark import Split, Subset, evaluate
from scenediff_classic.evaluation.rules import Mode
from scenediff_classic.evaluation.tables import pair_table, summary_table, to_json
from scenediff_classic.features.named import FeatureName
from scenediff_classic.pipeline import DetectConfig, detect_changes
from scenediff_classic.presets import Preset, StereoMethod, configured, weight_files
from scenediff_classic.regions.named import RegionName
from scenediff_classic.terminal import (
    ERR,
    OUT,
    print_notes,
    print_outcome,
    progress_bars,
    run_command,
    shown,
)


@dataclass(frozen=True)
class Detect:
    """Find what was added, removed or moved between two captures of a place.

    Each capture is a video file, a folder of photos, or one photo.
    """

    before: tyro.conf.Positional[Path]
    """The earlier capture."""
    after: tyro.conf.Positional[Path]
    """The later capture."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the result; made anew. A killed run with the same call continues."""
    preset: Preset = "balanced"
    """Trade-off between time and detail; fast is for a first look."""
    fps: float = 1.0
    """Frames per second taken of a video."""
    long_side: int | None = None
    """Working size: longer side in pixels (fast 320, balanced 512, accurate 768)."""
    geometry: Path | None = None
    """Known cameras and depth: an .npz, a COLMAP model with depth maps, a depth-camera folder, or
    the output folder of an earlier run. Left out: computed from the pictures."""
    before_range: tuple[float, float] | None = None
    """Seconds of the before video to use: start end."""
    after_range: tuple[float, float] | None = None
    """Seconds of the after video to use: start end."""
    before_ignore: Path | None = None
    """Folder of masks of dynamic content in the before capture (not zero = ignore)."""
    after_ignore: Path | None = None
    """The same for the after capture."""
    seed: int = 0
    """Same seed and device, same result."""
    device: Device = "auto"
    """Where stereo and learned models compute: auto is cuda if PyTorch finds a CUDA device,
    otherwise cpu. All other stages run on the CPU."""
    stereo: StereoMethod | None = None
    """How depth is matched: a plane sweep takes less time and is less exact, except in small
    pictures. If left out, as the preset has it: a plane sweep for fast."""
    regions: RegionName = "boundary-merging"
    """How pictures are cut into regions: by the strength of borders, or whole things first that
    stand before large planes."""
    features: FeatureName = "gradient-colour"
    """How the looks of surfaces are compared: gradients, SIFT, binary patterns and colours."""
    learned_features: str | None = None
    """Features of a DINOv2 or DINOv3 model instead of classical ones: a folder with its weights, or
    its id in your Hugging Face cache. Needs the extra "learned"."""
    learned_regions: str | None = None
    """Regions of a SAM or SAM 2 model instead of classical ones: the same."""
    learned_matching: Path | None = None
    """Register with ALIKED and LightGlue instead of SIFT: a folder with aliked-n16rot.onnx and
    aliked-lightglue.onnx. Needs a pycolmap with ONNX."""
    allow_download: bool = False
    """Fetch weights of DINO and SAM from the Hugging Face hub; otherwise only this computer is
    searched."""
    overwrite: bool = False
    """Replace the result of another run in the output folder."""
    scoring: ScoringConfig = field(default_factory=ScoringConfig)
    threshold: ThresholdConfig = field(default_factory=ThresholdConfig)
    objects: ObjectConfig = field(default_factory=ObjectConfig)
    still_there: StillThereConfig = field(default_factory=StillThereConfig)
    outlines: OutlineConfig = field(default_factory=OutlineConfig)
    moves: MoveConfig = field(default_factory=MoveConfig)

    def __call__(self) -> None:
        """Run the detection and say what was found."""
        base = DetectConfig(
            scoring=self.scoring, threshold=self.threshold, objects=self.objects,
            still_there=self.still_there, outlines=self.outlines, moves=self.moves,
        )  # fmt: skip
        config = configured(
            self.preset, long_side=self.long_side, seed=self.seed, geometry=self.geometry,
            device=self.device, stereo=self.stereo, features=self.features, regions=self.regions,
            learned_features=self.learned_features, learned_regions=self.learned_regions,
            learned_matching=self.learned_matching, allow_download=self.allow_download, base=base,
        )  # fmt: skip
        known = () if self.geometry is None else (self.geometry,)
        with progress_bars() as progress:
            result = run_detection(
                self._capture(self.before, self.before_range, self.before_ignore),
                self._capture(self.after, self.after_range, self.after_ignore),
                self.out,
                lambda before, after, workspace, progress: detect_changes(
                    before, after, config, workspace=workspace, progress=progress
                ),
                config,
                seed=self.seed,
                overwrite=self.overwrite,
                uses=(*known, *weight_files(config)),
                command=tuple(sys.argv),
                progress=progress,
            )
        print_outcome(result, self.out)

    def _capture(
        self, path: Path, part: tuple[float, float] | None, ignore: Path | None
    ) -> CaptureOptions:
        start, end = part if part is not None else (0.0, None)
        return CaptureOptions(path, self.fps, start, end, ignore)


@dataclass(frozen=True)
class Evaluate:
    """Score predictions against annotations: px/im IoU, obj/im AP, obj/sc AP, type-aware AP."""

    predictions: tyro.conf.Positional[Path]
    """Folder with <pair>/changes.json or <pair>/object_masks.pkl."""
    truth: tyro.conf.Positional[Path]
    """Folder with <pair>/segments.json or <pair>/segments.pkl, or a benchmark's root."""
    mode: Mode = "strict"
    """strict: as the paper says; official: as the published evaluator computes."""
    split: Split | None = None
    """Only the pairs of this split file."""
    subset: Subset | None = None
    """Only the pairs of this subset of the split."""
    json: bool = False
    """Print JSON instead of tables."""

    def __call__(self) -> None:
        """Print the tables."""
        with progress_bars() as progress:
            scores = evaluate(
                self.predictions, self.truth, self.mode,
                split=self.split, subset=self.subset, progress=progress,
            )  # fmt: skip
        if self.json:
            print(to_json(scores))
            return
        OUT.print(pair_table(scores))
        OUT.print(summary_table(scores))
        print_notes(scores.warnings)


@dataclass(frozen=True)
class Export:
    """Write a finished result in another tool's format."""

    out: tyro.conf.Positional[Path]
    """Output folder of a finished run."""
    format: ExportFormat = "scenediff"
    """scenediff: object_masks.pkl as in the benchmark; coco: COCO JSON."""
    destination: Path | None = None
    """File or folder to write to; left out: the output folder."""

    def __call__(self) -> None:
        """Write the file and name it."""
        written = export(self.out, self.format, self.destination)
        OUT.print(f"Wrote {shown(written)}", soft_wrap=True)


def main() -> None:
    """Run a subcommand; exit code 0 = done, 2 = input or set-up is at fault, 130 = interrupted."""
    logging.basicConfig(
        level=logging.WARNING, format="%(message)s", handlers=[RichHandler(console=ERR)]
    )

    def command() -> None:
        tyro.extras.subcommand_cli_from_dict(
            {"detect": Detect, "evaluate": Evaluate, "export": Export},
            description="Object-level change detection between two captures of a scene.",
        )()

    code = run_command(command)
    if code:
        sys.exit(code)


if __name__ == "__main__":
    main()
