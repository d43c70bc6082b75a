"""Geometry from the pictures alone: registration, then stereo, then marked completion."""

from dataclasses import dataclass, field
from pathlib import Path

from scenediff_classic.geometry.registration.structure_from_motion import StructureFromMotion
from scenediff_classic.geometry.stereo.completion import DepthCompletion
from scenediff_classic.geometry.stereo.multi_view import MultiViewStereo
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.types import Capture, Geometry


@dataclass(frozen=True)
class GeometryFromPictures:
    """Joint structure from motion over both captures, multi-view stereo within each."""

    registration: StructureFromMotion = field(default_factory=StructureFromMotion)
    stereo: MultiViewStereo = field(default_factory=MultiViewStereo)
    completion: DepthCompletion | None = field(default_factory=DepthCompletion)

    def __call__(
        self, before: Capture, after: Capture, workspace: Path, progress: Progress = silent
    ) -> Geometry:
        """Cameras, depth and completed depth; finished frames are kept in `workspace`."""
        geometry = self.registration(before, after, workspace, progress)
        geometry = self.stereo(geometry, workspace, progress)
        return geometry if self.completion is None else self.completion(geometry)
