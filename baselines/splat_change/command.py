"""The command line of both detectors: inputs and outputs as of ``scenediff-classic detect``."""

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from baselines.splat_change.models import ModelConfig
from baselines.splat_change.sam_boxes import SamBoxes
from scenediff_classic.detection_run import CaptureOptions, Detect, run_detection
from scenediff_classic.devices import Device
from scenediff_classic.errors import InputError
from scenediff_classic.features.dino import DinoFeatures
from scenediff_classic.features.named import FEATURES, FeatureName
from scenediff_classic.presets import Preset, configured
from scenediff_classic.protocols import FeatureExtractor, GeometryEstimator
from scenediff_classic.terminal import print_outcome, progress_bars


@dataclass(frozen=True)
class DetectCommand:
    """Find what was added, removed or moved between two captures of a place.

    Each capture is a video file, a folder of photos, or one photo.
    """

    before: tyro.conf.Positional[Path]
    """The earlier capture."""
    after: tyro.conf.Positional[Path]
    """The later capture."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the result; made anew. A killed run with the same call continues, in the middle of
    a model as well."""
    preset: Preset = "balanced"
    """Of the geometry: trade-off between time and detail."""
    fps: float = 1.0
    """Frames per second taken of a video."""
    every: int = 1
    """Only every n-th frame is searched for changes; all are learned. In the paper, --fps 3
    --every 3."""
    geometry: Path | None = None
    """Known cameras and depth, such as the output folder of scenediff-classic detect."""
    before_range: tuple[float, float] | None = None
    """Seconds of the before video to use: start end."""
    after_range: tuple[float, float] | None = None
    """Seconds of the after video to use: start end."""
    before_ignore: Path | None = None
    """Folder of masks of dynamic content in the before capture (not zero = ignore)."""
    after_ignore: Path | None = None
    """The same for the after capture."""
    features: FeatureName | None = None
    """How the looks of surfaces are compared."""
    learned_features: str | None = None
    """Features of a DINOv2 or DINOv3 model instead: a folder with its weights, or its id in your
    Hugging Face cache. Needs the extra "learned"."""
    long_side: int = 320
    """Longer side of the pictures that are learned and rendered, in pixels."""
    iterations: int = 400
    """Of the training of each capture's model."""
    points: int = 20_000
    """Gaussians of each model at the start, at most."""
    seed: int = 0
    device: Device = "cpu"
    """Where Gaussians are learned: cuda needs the package gsplat."""
    pictures: Path | None = None
    """Folder for pictures of every compared view, side by side: captured, rendered, how much
    differs, what was found."""
    overwrite: bool = False
    """Replace the result of another run in the output folder."""

    @property
    def known_geometry(self) -> GeometryEstimator:
        """Where cameras and depth come from."""
        return configured(self.preset, seed=self.seed, geometry=self.geometry).geometry

    @property
    def models(self) -> ModelConfig:
        """Options of the models.

        Raises
        ------
        InputError
            If a number is out of range.
        """
        least = {"every": 1, "long_side": 64, "iterations": 1, "points": 100}
        for name, low in least.items():
            if getattr(self, name) < low:
                option = name.replace("_", "-")
                raise InputError(f"--{option} must be at least {low}, not {getattr(self, name)}.")
        base = ModelConfig()
        train = replace(
            base.train, iterations=self.iterations, degree_every=max(self.iterations // 2, 1),
            seed=self.seed, device=self.device,
        )  # fmt: skip
        return ModelConfig(self.long_side, self.points, self.every, train)

    def extractor(self, default: FeatureExtractor) -> FeatureExtractor:
        """The features that were asked for."""
        if self.learned_features is not None:
            return DinoFeatures(self.learned_features)
        return default if self.features is None else FEATURES[self.features]

    def detected(self, detect: Detect, config: Any, *learned: object) -> None:
        """Detect, write the folder, say what was found.

        Parameters
        ----------
        learned
            Plug-ins; what the files of learned ones hold decides the result.
        """
        known = () if self.geometry is None else (self.geometry,)
        files = tuple(
            file for p in learned if isinstance(p, (DinoFeatures, SamBoxes)) for file in p.files
        )
        with progress_bars() as progress:
            result = run_detection(
                self._capture(self.before, self.before_range, self.before_ignore),
                self._capture(self.after, self.after_range, self.after_ignore),
                self.out,
                detect,
                config,
                seed=self.seed,
                overwrite=self.overwrite,
                uses=(*known, *files),
                command=tuple(sys.argv),
                progress=progress,
            )
        print_outcome(result, self.out)

    def _capture(
        self, path: Path, part: tuple[float, float] | None, ignore: Path | None
    ) -> CaptureOptions:
        start, end = part if part is not None else (0.0, None)
        return CaptureOptions(path, self.fps, start, end, ignore)
