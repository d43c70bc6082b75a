"""CYWS over whole captures, as the paper compares it: view pairs, boxes, masks, objects."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Int32

from baselines.cyws.boxes import PAIRED, Corners
from baselines.cyws.presets import Dimension
from baselines.cyws.raw_boxes import NAME, RawBox, Spot, boxes_text, source_box
from baselines.cyws.view_boxes import FoundBox, view_boxes
from baselines.cyws.weights import SHIPPED, load_network
from scenediff_classic.cameras import mask_to_source, project, sample, unproject
from scenediff_classic.change.changed_regions import ChangedRegion, ObjectConfig, main_parts
from scenediff_classic.change.describe import ConfidenceConfig, describe
from scenediff_classic.change.moves import Change
from scenediff_classic.change.objects import SceneObject, similarity
from scenediff_classic.change.scale import normalised, rescaled
from scenediff_classic.change.visibility import VisibilityConfig, pair_views
from scenediff_classic.devices import Device, chosen_device
from scenediff_classic.errors import AlignmentError
from scenediff_classic.geometry.from_pictures import GeometryFromPictures
from scenediff_classic.masks import encode
from scenediff_classic.protocols import GeometryEstimator, Progress, RegionProposer, silent
from scenediff_classic.regions.boundary_merging import BoundaryMergingRegions
from scenediff_classic.types import (
    VIDEOS,
    Capture,
    ChangeResult,
    Evidence,
    FrameInfo,
    Geometry,
    Regions,
    ScoreMaps,
    TermScores,
    VideoInfo,
    View,
)


@dataclass(frozen=True)
class CywsConfig:
    """Options of the baseline."""

    model: Dimension = "3d"
    weights: Path | None = None
    """None = those that were trained here."""
    geometry: GeometryEstimator = field(default_factory=GeometryFromPictures)
    regions: RegionProposer = field(default_factory=BoundaryMergingRegions)
    least: float = 0.3
    """Score below which boxes are dropped."""
    inside: float = 0.6
    """Share of a region that must lie in a box to belong to its mask."""
    nearer: float = 0.01
    """How much nearer than the other view's surface an object must be to stand in a view rather
    than to be missing in it, in normalised units (the scene's extent is 1)."""
    device: Device = "auto"
    visibility: VisibilityConfig = field(default_factory=VisibilityConfig)
    objects: ObjectConfig = field(default_factory=ObjectConfig)

    @property
    def file(self) -> Path:
        """Where the weights are."""
        return SHIPPED[self.model] if self.weights is None else self.weights


@dataclass(frozen=True)
class _AsScored(ConfidenceConfig):
    """An object is as sure as its boxes."""

    def __call__(self, score: float, frames: float, placed: int) -> float:
        return score


def detect_with_cyws(
    before: Capture,
    after: Capture,
    config: CywsConfig = CywsConfig(),
    *,
    workspace: Path,
    progress: Progress = silent,
) -> tuple[ChangeResult, Evidence]:
    """Find changed objects by the boxes of a CYWS network in all co-visible pairs of views.

    Boxes become masks by the regions that they hold; those that show where something is missing
    are told from those that show it by depth, and dropped. Masks of a capture that share their
    place in space are one object. Nothing is called moved: the networks do not say so.

    Raises
    ------
    AlignmentError
        If the captures cannot be brought into one world frame.
    InputError
        If the weights cannot be used.
    """
    network, preset = load_network(config.file)
    seconds, start = {}, time.perf_counter()
    estimated = config.geometry(before, after, workspace, progress)
    geometry = normalised(estimated)
    if not all(geometry.of(video) for video in VIDEOS):
        raise AlignmentError("No picture of one capture could be placed in the other's scene.")
    seconds["geometry"], start = time.perf_counter() - start, time.perf_counter()
    pairs = pair_views(geometry, config.visibility)
    least, device = min(config.least, PAIRED), chosen_device(config.device)
    boxes = view_boxes(network, preset, geometry, pairs, least, device, progress)
    seconds["boxes"], start = time.perf_counter() - start, time.perf_counter()
    found, maps, proposals = [], [], []
    for k, view in enumerate(geometry.views):
        proposals.append(config.regions(view))
        others = [geometry.views[a + b - k] for a, b in pairs if k in (a, b)]
        here = _regions_of_boxes(k, view, proposals[k], boxes[k], others, config)
        found.extend(here)
        maps.append(_maps(view, here))
        progress("masks", k + 1, len(geometry.views))
    described = describe(_changes(found, geometry, config.objects), geometry, 0.0, _AsScored())
    # the terms are those of another method, and no pair of frames was compared for them
    items = tuple(replace(item, support=None) for item in described)
    seconds["masks"] = time.perf_counter() - start
    result = ChangeResult(
        before=_info(before, geometry),
        after=_info(after, geometry),
        objects=items,
        threshold=config.least if items else None,
        scale=geometry.unit,
        warnings=(*before.warnings, *after.warnings, *geometry.warnings),
        bridge=geometry.bridge,
    )
    world = estimated if estimated.unit == 1 else rescaled(estimated, 1 / estimated.unit)
    files = {NAME: boxes_text(_as_reported(geometry, proposals, boxes, config.inside))}
    return result, Evidence(world, tuple(maps), pairs, seconds, files=files)


# --- from boxes to objects ----------------------------------------------------------------------


def box_mask(
    labels: Int32[np.ndarray, "h w"], box: Sequence[float], inside: float
) -> Bool[np.ndarray, "h w"]:
    """The regions that lie in a box by a share of `inside`; the box itself if there is none."""
    height, width = labels.shape
    within = np.zeros(labels.shape, bool)
    x0, y0, x1, y1 = (round(v) for v in box)
    within[max(y0, 0) : min(y1, height), max(x0, 0) : min(x1, width)] = True
    known = labels >= 0
    total = np.bincount(labels[known], minlength=1)
    held = np.bincount(labels[known & within], minlength=len(total))
    chosen = np.flatnonzero((held > 0) & (held >= inside * total))
    mask = np.isin(labels, chosen) & within
    return mask if mask.any() else within


def _regions_of_boxes(
    k: int,
    view: View,
    proposal: Regions,
    boxes: Sequence[FoundBox],
    others: Sequence[View],
    config: CywsConfig,
) -> list[ChangedRegion]:
    out, points = [], unproject(view)
    for number, box in enumerate(b for b in boxes if b.score > config.least):
        mask = box_mask(proposal.labels, box.xyxy, config.inside) & ~view.ignore
        cloud = points[mask]
        cloud = cloud[np.isfinite(cloud).all(axis=1)].astype(np.float64)
        if not len(cloud) or not _stands(cloud, others, config.nearer):
            continue
        out.append(
            ChangedRegion(
                view=k,
                label=number,
                mask=mask,
                score=box.score,
                terms=TermScores(0.0, 0.0, 0.0),
                descriptor=np.ones(1, np.float32),
                points=main_parts(cloud, config.objects),
            )
        )
    return out


def _as_reported(
    geometry: Geometry,
    proposals: Sequence[Regions],
    boxes: Sequence[Sequence[FoundBox]],
    inside: float,
) -> list[RawBox]:
    """All boxes, those that became no object among them, in pixels of the input pictures."""

    def spot(k: int, xyxy: Corners) -> Spot:
        view = geometry.views[k]
        mask = box_mask(proposals[k].labels, xyxy, inside) & ~view.ignore
        in_source = encode(mask_to_source(mask, view.lens, view.intrinsics))
        return Spot(view.video, view.index, source_box(xyxy, view), in_source)

    return [
        RawBox(
            spot(k, box.xyxy),
            box.score,
            box.partner and spot(box.partner.view, box.partner.xyxy),
        )
        for k, found in enumerate(boxes)
        for box in found
    ]


def _stands(points: np.ndarray, others: Sequence[View], nearer: float) -> bool:
    """Whether most views of the other capture see through the points, to something behind."""
    votes: list[bool] = []
    for view in others:
        xy, z = project(points, view.intrinsics, view.cam_from_world)
        behind = sample(view.depth, xy[None], nearest=True)[0] - z
        known = behind[np.isfinite(behind)]
        if len(known):
            votes.append(bool(np.median(known) > nearer))
    return bool(votes) and 2 * sum(votes) >= len(votes)


def _changes(
    regions: Sequence[ChangedRegion], geometry: Geometry, config: ObjectConfig
) -> list[Change]:
    changes = []
    for video in VIDEOS:
        groups: list[list[ChangedRegion]] = []
        own = [r for r in regions if geometry.views[r.view].video == video]
        for region in sorted(own, key=lambda r: (-r.score, r.view, r.label)):
            # all descriptors are equal: one, and the share of points that are near
            scores = [similarity(group, [region], config) for group in groups]
            best = int(np.argmax(scores)) if scores else -1
            if best >= 0 and np.isfinite(scores[best]):
                groups[best].append(region)
            else:
                groups.append([region])
        for group in groups:
            item = SceneObject(video, tuple(group))
            sides = (item, None) if video == "before" else (None, item)
            changes.append(Change(*sides, None))
    return changes


def _maps(view: View, regions: Sequence[ChangedRegion]) -> ScoreMaps:
    total = np.zeros(view.shape, np.float32)
    for region in regions:
        total[region.mask] = np.maximum(total[region.mask], region.score)
    none: Any = np.full(view.shape, np.nan, np.float32)
    return ScoreMaps(none, none, none, total)


def _info(capture: Capture, geometry: Geometry) -> VideoInfo:
    left_out = {(u.video, u.index): u.reason for u in geometry.unregistered}
    placed = {v.key: v.placement for v in geometry.views}
    frames = tuple(
        FrameInfo(
            f.index,
            f.name,
            f.time_s,
            f.width,
            f.height,
            (f.video, f.index) in placed,
            left_out.get((f.video, f.index)),
            placed.get((f.video, f.index)),
        )
        for f in capture.frames
    )
    return VideoInfo(capture.source, frames)
