"""The method, readable top to bottom (paper Sec. 4)."""

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from scenediff_classic.change.changed_regions import ObjectConfig, changed_regions
from scenediff_classic.change.describe import ConfidenceConfig, describe
from scenediff_classic.change.moves import Change, MoveConfig, pair_moves
from scenediff_classic.change.objects import group_objects
from scenediff_classic.change.outlines import OutlineConfig, redrawn
from scenediff_classic.change.scale import normalised, rescaled
from scenediff_classic.change.scoring import Scores, ScoringConfig, score_changes
from scenediff_classic.change.still_there import (
    LIGHT_WARNING,
    StillThereConfig,
    without_still_there,
)
from scenediff_classic.change.threshold import ThresholdConfig, change_threshold
from scenediff_classic.errors import AlignmentError
from scenediff_classic.features.named import FEATURES
from scenediff_classic.geometry.from_pictures import GeometryFromPictures
from scenediff_classic.protocols import (
    FeatureExtractor,
    GeometryEstimator,
    Progress,
    RegionProposer,
    silent,
)
from scenediff_classic.regions.boundary_merging import BoundaryMergingRegions
from scenediff_classic.types import (
    Capture,
    ChangeResult,
    Evidence,
    FrameInfo,
    Geometry,
    Regions,
    VideoInfo,
)


@dataclass(frozen=True)
class DetectConfig:
    """All options of the method; every field is itself a plug-in or its options."""

    geometry: GeometryEstimator = field(default_factory=GeometryFromPictures)
    regions: RegionProposer = field(default_factory=BoundaryMergingRegions)
    features: FeatureExtractor = FEATURES["gradient-colour"]
    scoring: ScoringConfig = field(default_factory=ScoringConfig)
    threshold: ThresholdConfig = field(default_factory=ThresholdConfig)
    objects: ObjectConfig = field(default_factory=ObjectConfig)
    still_there: StillThereConfig = field(default_factory=StillThereConfig)
    outlines: OutlineConfig = field(default_factory=OutlineConfig)
    moves: MoveConfig = field(default_factory=MoveConfig)
    confidence: ConfidenceConfig = field(default_factory=ConfidenceConfig)


def detect_changes(
    before: Capture,
    after: Capture,
    config: DetectConfig = DetectConfig(),
    *,
    workspace: Path | None = None,
    progress: Progress = silent,
) -> tuple[ChangeResult, Evidence]:
    """Find the objects that were added, removed or moved between two captures.

    Parameters
    ----------
    before, after : Capture
        From `scenediff_classic.video.read_capture`, or made by hand from arrays.
    workspace : Path, optional
        Folder for finished stages: a second call with the same folder and the same input
        continues where the first one stopped. A temporary folder if left out.

    Returns
    -------
    result : ChangeResult
        The changed objects, masks at the input's resolution, positions in the geometry's world.
    evidence : Evidence
        Geometry, score maps and compared view pairs, for reports and diagnosis.

    Raises
    ------
    AlignmentError
        If the captures cannot be brought into one world frame, or no depth can be measured.
    """
    clock = _Clock()
    with clock.stage("geometry"), _folder(workspace) as folder:
        estimated = config.geometry(before, after, folder, progress)
        geometry = normalised(estimated)
    _require_both(geometry)
    with clock.stage("regions"):
        regions = []
        for k, view in enumerate(geometry.views):
            regions.append(config.regions(view))
            progress("regions", k + 1, len(geometry.views))
    with clock.stage("scores"):
        scores = score_changes(
            geometry, regions, config.features, config.scoring, progress, workspace
        )
    with clock.stage("objects"):
        result = decided(before, after, geometry, regions, scores, config)
    # never back from the unit's world: that would leave rounding noise in every camera
    world = estimated if estimated.unit == 1 else rescaled(estimated, 1 / estimated.unit)
    return result, Evidence(world, scores.maps, scores.pairs, clock.seconds)


def decided(
    before: Capture,
    after: Capture,
    geometry: Geometry,
    regions: Sequence[Regions],
    scores: Scores,
    config: DetectConfig,
) -> ChangeResult:
    """From scores to changed objects: the quick half of the method.

    Parameters
    ----------
    geometry : Geometry
        In normalised units (`change.scale.normalised`), with views of both captures.
    regions : sequence of Regions
        One per view.
    scores : Scores
        From `change.scoring.score_changes`.
    """
    threshold = change_threshold(scores.maps, config.threshold)
    changed = changed_regions(geometry, regions, scores, threshold, config.objects)
    objects = group_objects(
        geometry, regions, changed, threshold, config.features.merge, config.objects
    )
    objects = without_still_there(objects, geometry, scores.light, config.still_there)
    objects = redrawn(objects, geometry, config.outlines)
    changes = pair_moves(objects, config.features.similarity, config.moves)
    if config.still_there.applies(scores.light):
        geometry = replace(geometry, warnings=(*geometry.warnings, LIGHT_WARNING))
    return answer(before, after, geometry, changes, threshold, config.confidence)


def answer(
    before: Capture,
    after: Capture,
    geometry: Geometry,
    changes: Sequence[Change],
    threshold: float,
    confidence: ConfidenceConfig,
) -> ChangeResult:
    """The changes as the result says them; `geometry` is in normalised units."""
    described = describe(changes, geometry, threshold, confidence)
    return ChangeResult(
        before=_info(before, geometry),
        after=_info(after, geometry),
        objects=described,
        threshold=threshold if described else None,
        scale=geometry.unit,
        warnings=(*before.warnings, *after.warnings, *geometry.warnings),
        bridge=geometry.bridge,
    )


def _require_both(geometry: Geometry) -> None:
    for video in ("before", "after"):
        if not geometry.of(video):
            raise AlignmentError(
                f"No picture of the {video} capture could be placed in the other's scene: "
                "the captures must show the same place from overlapping viewpoints."
            )


def _info(capture: Capture, geometry: Geometry) -> VideoInfo:
    left_out = {(u.video, u.index): u.reason for u in geometry.unregistered}
    placed = {v.key: v.placement for v in geometry.views}
    frames = tuple(
        FrameInfo(
            index=f.index,
            name=f.name,
            time_s=f.time_s,
            width=f.width,
            height=f.height,
            registered=(f.video, f.index) in placed,
            reason=left_out.get((f.video, f.index)),
            placement=placed.get((f.video, f.index)),
        )
        for f in capture.frames
    )
    return VideoInfo(capture.source, frames)


@contextmanager
def _folder(workspace: Path | None) -> Iterator[Path]:
    if workspace is not None:
        yield workspace
        return
    with tempfile.TemporaryDirectory(prefix="scenediff-") as name:
        yield Path(name)


class _Clock:
    def __init__(self, now: Callable[[], float] = time.perf_counter) -> None:
        self.seconds: dict[str, float] = {}
        self._now = now

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start = self._now()
        yield
        self.seconds[name] = self._now() - start
