"""The truth in place of one stage of the method, and all other stages as they are.

Where the truth can be a plug-in it is one: `MixedGeometry`, `TrueRegions`, `TrueFeatures`. The
others take the place of the method's quick half (`pipeline.decided`): `TrueScores` and
`TrueAssociation`.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float32

from data_tools.benchmarks.rendered_truth import RenderedTruth
from data_tools.benchmarks.stages import Stages
from scenediff_classic.cameras import pixel_centres, sample, source_from_view, view_from_source
from scenediff_classic.change.changed_regions import ChangedRegion, changed_regions
from scenediff_classic.change.moves import Change, judged, pair_moves
from scenediff_classic.change.objects import SceneObject, established, group_objects
from scenediff_classic.change.outlines import redrawn
from scenediff_classic.change.region_pooling import paint, region_means
from scenediff_classic.change.scoring import RegionScores
from scenediff_classic.change.still_there import without_still_there
from scenediff_classic.change.threshold import change_threshold
from scenediff_classic.errors import AlignmentError
from scenediff_classic.geometry.known_cameras import NpzGeometry
from scenediff_classic.pipeline import DetectConfig, answer, decided
from scenediff_classic.protocols import GeometryEstimator, Progress, RegionProposer, silent
from scenediff_classic.types import (
    Capture,
    ChangeResult,
    Geometry,
    Regions,
    ScoreMaps,
    SparsePoints,
    Video,
    View,
)

Depth = Literal["estimated", "true", "true where found", "true where missing"]


@dataclass(frozen=True)
class MixedGeometry:
    """Cameras from one source and depth from the other.

    The unit of the estimate is the median ratio of its measured depth to the true one. "Where
    found" corrects what the estimate has, measured or guessed, and leaves its holes; "where
    missing" keeps what it measured and gives the rest.
    """

    estimated: GeometryEstimator
    truth: Path
    """A pair's ``truth_geometry.npz``."""
    cameras: Literal["estimated", "true"] = "estimated"
    depth: Depth = "estimated"
    long_side: int = 512

    def __call__(
        self, before: Capture, after: Capture, workspace: Path, progress: Progress = silent
    ) -> Geometry:
        """Only frames that the estimate has placed."""
        return self.derived(self.estimated(before, after, workspace, progress), before, after)

    def derived(self, geometry: Geometry, before: Capture, after: Capture) -> Geometry:
        """What becomes of the estimate."""
        source = NpzGeometry(self.truth, self.long_side)
        known = source(before, after, self.truth.parent, silent)
        by_key = {view.key: view for view in known.views}
        true = [by_key[view.key] for view in geometry.views]
        unit = _unit(geometry.views, true)
        views = [self._mixed(e, t, unit) for e, t in zip(geometry.views, true, strict=True)]
        points = SparsePoints.none() if self.cameras == "true" else geometry.points
        return replace(geometry, views=tuple(views), points=points)

    def _mixed(self, estimated: View, true: View, unit: float) -> View:
        """In the world of the cameras."""
        base, to_true, to_estimated = (
            (true, 1.0, 1 / unit) if self.cameras == "true" else (estimated, unit, 1.0)
        )
        found, exact = carried(estimated, base), carried(true, base)
        depth, confidence = found.depth * np.float32(to_estimated), found.confidence
        measured, truth = found.measured, exact.depth * np.float32(to_true)
        if self.depth != "estimated":
            use = np.isfinite(truth)
            if self.depth == "true where found":  # a guess stays one, but is right
                use &= np.isfinite(depth)
            else:
                use &= ~measured if self.depth == "true where missing" else True
                measured = measured | use
            depth = np.where(use, truth, depth)
            confidence = np.where(use, np.float32(1), confidence)
        return replace(
            base,
            depth=depth.astype(np.float32),
            confidence=confidence.astype(np.float32),
            measured=measured & np.isfinite(depth),
            placement=estimated.placement,
        )


def carried(source: View, target: View) -> View:
    """The depth of a view at the pixels of another one of the same frame (nearest)."""
    xy = source_from_view(pixel_centres(*target.shape), target.lens, target.intrinsics)
    xy = view_from_source(xy, source.lens, source.intrinsics)

    def at(values: np.ndarray) -> Float32[np.ndarray, "h w"]:
        return sample(values.astype(np.float32), xy - 1e-6, nearest=True)

    return replace(
        target,
        depth=at(source.depth),
        confidence=np.nan_to_num(at(source.confidence)),
        measured=np.nan_to_num(at(source.measured)) > 0.5,
    )


def _unit(estimated: Sequence[View], true: Sequence[View]) -> float:
    """Length in the estimate's world of one unit of the truth."""
    ratios = []
    for mine, theirs in zip(estimated, true, strict=True):
        ratio = mine.depth / carried(theirs, mine).depth
        ratios.append(ratio[mine.measured & np.isfinite(ratio)])
    pooled = np.concatenate(ratios)
    if len(pooled) == 0:
        raise AlignmentError("No measured depth can be compared with the truth.")
    return float(np.median(pooled))


@dataclass(frozen=True)
class TrueRegions:
    """Every thing that is no furniture is one region, the rest is as another proposer has it."""

    truth: RenderedTruth
    rest: RegionProposer

    def __call__(self, view: View) -> Regions:
        """See the class."""
        proposal = self.rest(view)
        instances = self.truth.instances(view)
        own = np.isin(instances, self.truth.things)
        labels = np.where(own, proposal.count + instances, proposal.labels)
        numbers, compact = np.unique(labels[labels >= 0], return_inverse=True)
        out = np.full(labels.shape, -1, np.int32)
        out[labels >= 0] = compact
        return Regions(out, len(numbers))


@dataclass(frozen=True)
class TrueFeatures:
    """One channel for each object and one for the room: alike means the same thing."""

    truth: RenderedTruth
    stride: int = 4
    """Pixels a cell."""
    similarity: float = 0.5
    merge: float = 1.4

    def __call__(self, view: View) -> Float32[np.ndarray, "h w c"]:
        """The object in the middle of each cell, one-hot."""
        instances = self.truth.instances(view)
        middle = instances[self.stride // 2 :: self.stride, self.stride // 2 :: self.stride]
        channels = max(self.truth.kinds, default=0) + 1
        return np.eye(channels, dtype=np.float32)[middle]


@dataclass(frozen=True)
class TrueScores:
    """A region's score is its share of truly changed pixels; more than half means changed."""

    truth: RenderedTruth

    def __call__(
        self, before: Capture, after: Capture, stages: Stages, config: DetectConfig
    ) -> ChangeResult:
        """Decide with true scores."""
        maps, regions = [], []
        for view, proposal, scored in zip(
            stages.geometry.views, stages.regions, stages.scores.regions, strict=True
        ):
            share, _ = region_means(self.truth.change(view).astype(np.float32), proposal)
            painted = paint(share, proposal.labels)
            maps.append(ScoreMaps(painted, painted, painted, painted))
            regions.append(RegionScores(share, share, share, share, scored.descriptors))
        scores = replace(  # no comparison of two views, which were not told the truth, has a say
            stages.scores, maps=tuple(maps), regions=tuple(regions), comparisons={}, light=0.0
        )
        config = replace(config, threshold=replace(config.threshold, fixed=0.5))
        return decided(before, after, stages.geometry, stages.regions, scores, config)


@dataclass(frozen=True)
class TrueAssociation:
    """Changed regions that lie mostly in the same changed object are that object.

    Regions of anything else (false ones) are grouped as ever.
    """

    truth: RenderedTruth
    moves: bool = False
    """Also say by identity which object moved."""

    def __call__(
        self, before: Capture, after: Capture, stages: Stages, config: DetectConfig
    ) -> ChangeResult:
        """Decide with true identities."""
        geometry, options = stages.geometry, config.objects
        threshold = change_threshold(stages.scores.maps, config.threshold)
        changed = changed_regions(geometry, stages.regions, stages.scores, threshold, options)
        groups: dict[tuple[Video, int], list[ChangedRegion]] = defaultdict(list)
        others = []
        for region in changed:
            number = self._owner(region, geometry)
            video = geometry.views[region.view].video
            (others if number is None else groups[video, number]).append(region)
        known: dict[tuple[Video, int], SceneObject] = {}
        for key, group in groups.items():
            if any(r.score > threshold for r in group):
                for item in established([group], geometry, threshold, options):
                    known[key] = item
        rest = group_objects(
            geometry, stages.regions, others, threshold, config.features.merge, options
        )
        outlined = redrawn([*known.values()], geometry, config.outlines)
        known = dict(zip(known, outlined, strict=True))
        rest = redrawn(rest, geometry, config.outlines)
        changes = []
        if self.moves:
            for number in self.truth.changed:
                old, new = known.pop(("before", number), None), known.pop(("after", number), None)
                if old and new:
                    limits = config.features.similarity, config.moves.max_size_ratio
                    changes.append(Change(old, new, judged(old, new, *limits)))
                elif old or new:
                    changes.append(Change(old, new, None))
        rest = [*known.values(), *rest]
        rest = without_still_there(rest, geometry, stages.scores.light, config.still_there)
        changes += pair_moves(rest, config.features.similarity, config.moves)
        return answer(before, after, geometry, changes, threshold, config.confidence)

    def _owner(self, region: ChangedRegion, geometry: Geometry) -> int | None:
        """The changed object that more than half of the region shows."""
        inside = self.truth.instances(geometry.views[region.view])[region.mask]
        counts = np.bincount(inside)
        number = int(counts.argmax())
        mostly = counts[number] > 0.5 * len(inside) and number in self.truth.changed
        return number if mostly else None
