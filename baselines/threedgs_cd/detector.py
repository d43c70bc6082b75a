"""3DGS-CD over two captures, in both directions, as it was run for the paper."""

import time
from dataclasses import dataclass, field, replace
from pathlib import Path

from baselines.splat_change.answering import (
    answered,
    comparisons_of,
    evidence,
    painted_scores,
    write_comparisons,
)
from baselines.splat_change.models import (
    DIRECTIONS,
    ModelConfig,
    compared,
    model,
    prepared,
    renders,
)
from baselines.splat_change.segmenting import GrabCutBoxes
from baselines.threedgs_cd.merging import MergeConfig, as_published, merged
from baselines.threedgs_cd.occupancy import OccupancyConfig, carved
from baselines.threedgs_cd.searching import Found, SearchConfig, searched
from baselines.threedgs_cd.surface_light import SurfaceLightConfig, relit
from scenediff_classic.geometry.from_pictures import GeometryFromPictures
from scenediff_classic.protocols import GeometryEstimator, Progress, silent
from scenediff_classic.types import VIDEOS, Capture, ChangeResult, Evidence, Video


@dataclass(frozen=True)
class ThreedgsCdConfig:
    """Options of the baseline."""

    geometry: GeometryEstimator = field(default_factory=GeometryFromPictures)
    models: ModelConfig = field(default_factory=ModelConfig)
    light: SurfaceLightConfig | None = field(default_factory=SurfaceLightConfig)
    """Renders are put in the picture's light before they are compared; None = compared as they are,
    as published."""
    search: SearchConfig = field(default_factory=SearchConfig)
    merge: MergeConfig = field(default_factory=MergeConfig)
    occupancy: OccupancyConfig | None = None
    """None: masks stay as they are, as in the paper; otherwise things are cut out of a grid."""
    both_outputs: bool = False
    """Each direction answers for itself, as published: a moved thing is reported twice."""


def published(config: ThreedgsCdConfig) -> ThreedgsCdConfig:
    """The same with the published behaviour, where it is known to be at fault."""
    search = config.search
    differences = replace(
        search.differences, floor=0.0, pooled=False, inside=0.0, cover=0.0, min_area=0.01
    )
    if isinstance(differences.segmenter, GrabCutBoxes):
        differences = replace(differences, segmenter=replace(differences.segmenter, contrast=0.0))
    association = replace(
        search.association, near=float("inf"), could_see=False, fullest_only=True, late=False
    )
    search = SearchConfig(differences, association, replace(search.poses, still=0.0, alike=0.0))
    return replace(config, light=None, search=search, both_outputs=True)


def detect_with_3dgs_cd(
    before: Capture,
    after: Capture,
    config: ThreedgsCdConfig = ThreedgsCdConfig(),
    *,
    workspace: Path,
    progress: Progress = silent,
    pictures: Path | None = None,
) -> tuple[ChangeResult, Evidence]:
    """Find changed things by comparing each capture with a model of the other one.

    Parameters
    ----------
    workspace : Path
        Geometry and models are kept there, and continued after an interruption.
    pictures : Path, optional
        Folder for pictures of every compared view: captured, rendered, difference, found.

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
    found: dict[Video, Found] = {}
    shown = {}
    for now, other in DIRECTIONS:
        ids = compared(geometry, now, config.models.every)
        views = [geometry.views[k] for k in ids]
        drawn = renders(gaussians[other], views)
        if config.light is not None:
            drawn = [relit(v, r, config.light) for v, r in zip(views, drawn, strict=True)]
        here = dict(zip(ids, drawn, strict=True))
        found[now] = searched(geometry, here, config.search, progress)
        shown |= here
    if config.occupancy is not None:
        for now, one in found.items():
            ids = compared(geometry, now, 1)
            solid = tuple(carved(thing, geometry, ids, config.occupancy) for thing in one.into)
            found[now] = replace(one, into=solid)
    forth, back = found["after"], found["before"]
    moved = []
    if config.both_outputs:
        changes, moved = as_published(forth, back)
    else:
        features = config.search.differences.features
        still = config.search.poses.still
        changes = merged(forth, back, features.similarity, still, config.merge)
    least = config.search.differences.segmenter.least
    result = answered(before, after, geometry, changes, least, moved)
    sides = [side for c in (*changes, *moved) for side in (c.before, c.after) if side]
    total = painted_scores([r for side in sides for r in side.regions], geometry)
    feature = forth.differences | back.differences
    pairs = comparisons_of(geometry, shown, feature, total)
    if pictures is not None:
        write_comparisons(pictures, geometry, pairs)
    seconds["things"] = time.perf_counter() - start
    return result, evidence(estimated, geometry, feature, total, seconds, pairs)
