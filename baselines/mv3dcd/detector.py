"""MV3DCD over two captures, in both directions, as it was run for the paper."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from baselines.mv3dcd.channel import FusionConfig, fused
from baselines.mv3dcd.cues import CueConfig
from baselines.splat_change.answering import (
    answered,
    comparisons_of,
    evidence,
    painted_scores,
    write_comparisons,
    write_mask,
)
from baselines.splat_change.models import DIRECTIONS, ModelConfig, compared, model, prepared
from scenediff_classic.cameras import unproject
from scenediff_classic.change.changed_regions import ChangedRegion, ObjectConfig, main_parts
from scenediff_classic.change.moves import MoveConfig, pair_moves
from scenediff_classic.change.objects import group_objects
from scenediff_classic.change.region_pooling import region_descriptors
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
    VIDEOS,
    Capture,
    ChangeResult,
    Evidence,
    Geometry,
    Regions,
    TermScores,
    View,
)


@dataclass(frozen=True)
class Mv3dcdConfig:
    """Options of the baseline."""

    geometry: GeometryEstimator = field(default_factory=GeometryFromPictures)
    models: ModelConfig = field(default_factory=ModelConfig)
    cues: CueConfig = field(default_factory=CueConfig)
    fusion: FusionConfig = field(default_factory=FusionConfig)
    regions: RegionProposer = field(default_factory=BoundaryMergingRegions)
    changed: float = 0.5
    """Channel from which on a pixel changed."""
    share: float = 0.6
    """A region belongs to the picture's capture if more than this share of its pixels changed."""
    objects: ObjectConfig = field(
        default_factory=lambda: ObjectConfig(min_feature=0.0, lone_margin=0.0)
    )
    """How regions of all views become things; not part of the published method, which has none.
    The core's limits on its own score do not apply."""
    moves: MoveConfig = field(default_factory=MoveConfig)


def published(config: Mv3dcdConfig) -> Mv3dcdConfig:
    """The same with the published behaviour, where it is known to be at fault."""
    return replace(config, cues=replace(config.cues, scale=None, channels=(0,)))


def positive_regions(
    k: int,
    view: View,
    proposal: Regions,
    change: Float[np.ndarray, "h w"],
    features: FeatureExtractor,
    config: Mv3dcdConfig,
) -> list[ChangedRegion]:
    """The regions of a view of which more than a share changed, with their mean change.

    Parameters
    ----------
    change : array (h, w)
        The channel; NaN = unknown, which counts as unchanged.
    """
    level = np.nan_to_num(change)
    total = np.bincount(proposal.labels[proposal.labels >= 0], minlength=proposal.count)
    inside = (proposal.labels >= 0) & (level > config.changed)
    changed = np.bincount(proposal.labels[inside], minlength=proposal.count)
    positive = np.flatnonzero((changed > config.share * total) & (total > 0))
    if not len(positive):
        return []
    points = unproject(view)
    descriptors = region_descriptors(features(view), proposal)
    out = []
    for label in positive:
        mask = (proposal.labels == label) & ~view.ignore
        if not mask.any():
            continue
        cloud = points[mask]
        cloud = cloud[np.isfinite(cloud).all(axis=1)].astype(np.float64)
        score = float(level[mask].mean())
        terms = TermScores(0.0, score, 0.0)
        place = main_parts(cloud, config.objects)
        out.append(ChangedRegion(k, int(label), mask, score, terms, descriptors[label], place))
    return out


def detect_with_mv3dcd(
    before: Capture,
    after: Capture,
    config: Mv3dcdConfig = Mv3dcdConfig(),
    *,
    workspace: Path,
    progress: Progress = silent,
    pictures: Path | None = None,
    symmetric: Path | None = None,
) -> tuple[ChangeResult, Evidence]:
    """Find changed things by a change channel on a model of the other capture.

    Parameters
    ----------
    workspace : Path
        Geometry and models are kept there, and continued after an interruption.
    pictures : Path, optional
        Folder for pictures of every compared view: captured, rendered, channel, found.
    symmetric : Path, optional
        Folder for masks of all that differs, whichever capture has it (see `symmetric_mask`).

    Raises
    ------
    AlignmentError
        If the captures cannot be brought into one world frame.
    """
    seconds, start = {}, time.perf_counter()
    estimated = config.geometry(before, after, workspace, progress)
    geometry = prepared(estimated, config.models.long_side)
    seconds["geometry"], start = time.perf_counter() - start, time.perf_counter()
    gaussians = {v: model(geometry, v, config.models, workspace, progress) for v in VIDEOS}
    seconds["models"], start = time.perf_counter() - start, time.perf_counter()
    change, cues, shown = {}, {}, {}
    for now, other in DIRECTIONS:
        found = fused(
            gaussians[other], geometry, compared(geometry, other, 1),
            compared(geometry, now, config.models.every), config.cues, config.fusion,
            config.models, workspace, progress,
        )  # fmt: skip
        change |= found.change
        cues |= found.masks
        shown |= found.reference
    seconds["channel"], start = time.perf_counter() - start, time.perf_counter()
    regions, proposals = _regions(geometry, change, config, progress)
    features = config.cues.features
    things = group_objects(
        geometry, proposals, regions, config.changed, features.merge, config.objects
    )
    changes = pair_moves(things, features.similarity, config.moves)
    result = answered(before, after, geometry, changes, config.changed)
    found_at = painted_scores([r for t in things for r in t.regions], geometry)
    pairs = comparisons_of(geometry, shown, change, found_at)
    if pictures is not None:
        write_comparisons(pictures, geometry, pairs)
    if symmetric is not None:
        for k in sorted(change):
            view = geometry.views[k]
            path = symmetric / f"{view.video}_{view.index:04d}.png"
            write_mask(path, symmetric_mask(change[k], config.changed))
    seconds["objects"] = time.perf_counter() - start
    return result, evidence(estimated, geometry, cues, change, seconds, pairs)


def symmetric_mask(change: Float[np.ndarray, "h w"], level: float) -> Bool[np.ndarray, "h w"]:
    """All that differs at a camera: what stands there, and what stood there in the other capture.

    Where the reference model knows nothing, nothing differs.
    """
    return np.nan_to_num(change) > level


def _regions(
    geometry: Geometry,
    change: dict[int, np.ndarray],
    config: Mv3dcdConfig,
    progress: Progress,
) -> tuple[list[ChangedRegion], Sequence[Regions]]:
    regions, proposals = [], []
    features = config.cues.features
    for k, view in enumerate(geometry.views):
        proposal = config.regions(view)
        proposals.append(proposal)
        if k in change:
            regions += positive_regions(k, view, proposal, change[k], features, config)
        progress("regions", k + 1, len(geometry.views))
    return regions, proposals
