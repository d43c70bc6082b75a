"""The plug-in points: any object with the right ``__call__`` fits.

The built-in plug-ins are frozen dataclasses whose fields are their options; the object that
holds the options *is* the plug-in.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32

from scenediff_classic.types import Capture, ChangeResult, Geometry, Regions, View

Progress = Callable[[str, int, int], None]
"""Called as ``progress(stage, done, total)``; total 0 = unknown."""


def silent(stage: str, done: int, total: int) -> None:
    """The progress callback that says nothing."""


@runtime_checkable
class GeometryEstimator(Protocol):
    """Cameras and depth of both captures in one world frame."""

    def __call__(
        self, before: Capture, after: Capture, workspace: Path, progress: Progress
    ) -> Geometry:
        """Keep finished work under `workspace`, so that a second call continues from there."""
        ...


@runtime_checkable
class FeatureExtractor(Protocol):
    """Dense descriptors, comparable across views by cosine similarity."""

    @property
    def similarity(self) -> float:
        """Cosine above which two objects count as the same one (the paper's tau_sim)."""
        ...

    @property
    def merge(self) -> float:
        """S_feat + S_geo above which two regions of a capture are one object (sigma_merge)."""
        ...

    def __call__(self, view: View) -> Float32[np.ndarray, "h w c"]:
        """Unit-length features on a regular grid that covers the whole picture."""
        ...


@runtime_checkable
class RegionProposer(Protocol):
    """Object-like regions of a view."""

    def __call__(self, view: View) -> Regions:
        """Regions do not overlap; pixels of no region are -1."""
        ...


@runtime_checkable
class ChangeDetector(Protocol):
    """Our method, and every baseline."""

    def __call__(self, before: Capture, after: Capture) -> ChangeResult:
        """Find what was added, removed or moved between the captures."""
        ...
