"""The project's own method."""

from baselines.registry import Method
from scenediff_classic.pipeline import detect_changes
from scenediff_classic.presets import weight_files

METHOD = Method(lambda base, seed: base, detect_changes, weight_files)
