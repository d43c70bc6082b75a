"""One direction of 3DGS-CD: the model of one capture against the pictures of the other."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float32

from baselines.splat_change.models import Render
from baselines.threedgs_cd.association import (
    AssociationConfig,
    apart,
    associated,
    fullest_first,
    often_seen,
    region,
)
from baselines.threedgs_cd.differences import (
    DifferenceConfig,
    ViewMasks,
    difference,
    things,
    thresholds,
)
from baselines.threedgs_cd.poses import Motion, PoseConfig, keypoints, motion, template
from scenediff_classic.change.changed_regions import ChangedRegion
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.types import VIDEOS, Geometry


@dataclass(frozen=True)
class SearchConfig:
    """Options of the steps."""

    differences: DifferenceConfig = field(default_factory=DifferenceConfig)
    association: AssociationConfig = field(default_factory=AssociationConfig)
    poses: PoseConfig = field(default_factory=PoseConfig)


@dataclass(frozen=True)
class Link:
    """Thing `out` of the model was found again as thing `into` of the pictures."""

    out: int
    into: int
    motion: Motion


@dataclass(frozen=True)
class Found:
    """What one direction says."""

    into: tuple[SceneObject, ...]
    """Things that only the pictures show."""
    out: tuple[SceneObject, ...]
    """Things that only the model has; their masks lie on its renders at the pictures' cameras."""
    links: tuple[Link, ...]
    differences: dict[int, Float32[np.ndarray, "h w"]]
    """By position of the view."""


def searched(
    geometry: Geometry,
    shown: dict[int, Render],
    config: SearchConfig,
    progress: Progress = silent,
) -> Found:
    """Compare the pictures of one capture with renders of the other one's model.

    Parameters
    ----------
    geometry : Geometry
        In normalised units.
    shown : dict
        What the model shows, by position of the view in the geometry; at least one view, all of
        one capture.
    """
    views = sorted(shown)
    now = geometry.views[views[0]].video
    earlier = VIDEOS[1 - VIDEOS.index(now)]
    maps = {k: difference(geometry.views[k], shown[k], config.differences) for k in views}
    levels = thresholds([maps[k] for k in views], config.differences)
    masks: dict[int, ViewMasks] = {}
    for k, level in zip(views, levels, strict=True):
        masks[k] = things(geometry.views[k], shown[k], maps[k], level, config.differences)
        progress(f"{now} masks", len(masks), len(views))
    into, out = [], []
    for k in views:
        here, there = _regions(k, geometry, shown[k], masks[k], config)
        into.append(here)
        out.append(there)
    chosen = config.association
    ins = associated(into, now, chosen)
    outs = associated(fullest_first(out, chosen), earlier, chosen)
    outs = often_seen(outs, geometry, views, chosen)
    links = _links(ins, outs, geometry, shown, masks, config)
    return Found(tuple(ins), tuple(outs), tuple(links), maps)


def _regions(
    k: int, geometry: Geometry, shown: Render, masks: ViewMasks, config: SearchConfig
) -> tuple[list[ChangedRegion], list[ChangedRegion]]:
    view = geometry.views[k]
    answers = []
    for source, segments in ((view, masks.into), (shown.as_view(view), masks.out)):
        grid = config.differences.features(source) if segments else np.zeros((1, 1, 1))
        answers.append(
            [
                region(k, number, source, s.mask & ~view.ignore, s.score, grid, config.association)
                for number, s in enumerate(segments)
                if (s.mask & ~view.ignore).any()
            ]
        )
    return answers[0], answers[1]


def _links(
    ins: Sequence[SceneObject],
    outs: Sequence[SceneObject],
    geometry: Geometry,
    shown: dict[int, Render],
    masks: dict[int, ViewMasks],
    config: SearchConfig,
) -> list[Link]:
    """Each thing of the model at most once, and each of the pictures: most keypoints first."""
    candidates = [
        (k, geometry.views[k], keypoints(geometry.views[k].image, m.changed, config.poses))
        for k, m in masks.items()
    ]
    found = []
    for number, thing in enumerate(outs):
        templates = []
        for r in thing.regions:
            seen = shown[r.view].as_view(geometry.views[r.view])
            templates.append(template(keypoints(seen.image, r.mask, config.poses), seen))
        answer = motion(templates, candidates, config.poses)
        if answer is None or not ins:
            continue
        moved = answer(thing.points)
        gaps = [apart(other.points, moved) for other in ins]
        nearest = int(np.argmin(gaps))
        alike = float(thing.descriptor @ ins[nearest].descriptor) >= config.poses.alike
        if alike and gaps[nearest] <= config.association.near:
            found.append(Link(number, nearest, answer))
    links: list[Link] = []
    for link in sorted(found, key=lambda link: -link.motion.inliers):
        if all(link.into != other.into for other in links):
            links.append(link)
    return links
