"""Object-level change detection between two captures of a scene, with classical geometry."""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from scenediff_classic.pipeline import DetectConfig, detect_changes
    from scenediff_classic.presets import configured
    from scenediff_classic.video import read_capture

# Open3D brings a TBB that numba finds, refuses, and warns about: ask for OpenMP first. It is said
# here because numba reads it once, before the first of its kernels that runs in parallel.
os.environ.setdefault("NUMBA_THREADING_LAYER_PRIORITY", "omp workqueue tbb")

_HOME = {
    "DetectConfig": "pipeline",
    "configured": "presets",
    "detect_changes": "pipeline",
    "read_capture": "video",
}

__all__ = ["DetectConfig", "configured", "detect_changes", "read_capture"]


def __getattr__(name: str) -> Any:
    """Import on first use: the pipeline needs seconds to load, and not everybody needs it."""
    if name not in _HOME:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
