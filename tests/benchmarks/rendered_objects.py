"""Rendered pairs as a feature extractor meets them, with the true objects in every view."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import gettempdir

import cv2
import numpy as np
from jaxtyping import Int

from scenediff_classic.cameras import camera_centre, unproject
from scenediff_classic.change.changed_regions import ChangedRegion, ObjectConfig
from scenediff_classic.change.harmonise import HarmoniseConfig, harmonised
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.change.region_pooling import region_descriptors
from scenediff_classic.change.scale import normalised
from scenediff_classic.change.visibility import VisibilityConfig, pair_views
from scenediff_classic.geometry.known_cameras import NpzGeometry
from scenediff_classic.protocols import silent
from scenediff_classic.types import VIDEOS, Geometry, Regions, TermScores, Video, View
from scenediff_classic.video import read_capture


@dataclass(frozen=True)
class RenderedPair:
    """Both captures with true geometry, before and after their light is made equal."""

    raw: Geometry
    equalised: Geometry
    instances: tuple[Int[np.ndarray, "h w"], ...]
    """Per view: number of the object at every pixel, 0 = the room."""
    kinds: Mapping[int, str]
    """Object -> fixed, unchanged, added, removed or moved."""
    compared: tuple[tuple[int, int], ...]
    """Views that the method would compare, from the nearest viewpoints to the farthest."""

    def some(self, count: int) -> tuple[tuple[int, int], ...]:
        """At most `count` of the compared views, from near to far in even steps."""
        chosen = np.linspace(0, len(self.compared) - 1, min(count, len(self.compared)))
        return tuple(self.compared[k] for k in chosen.round().astype(int))


def read_rendered_pair(folder: Path, long_side: int = 512) -> RenderedPair:
    """Pictures, true geometry and true objects of a folder of ``data_tools.synthetic_pairs``."""
    before, after = (read_capture(folder / video, video) for video in VIDEOS)
    source = NpzGeometry(folder / "truth_geometry.npz", long_side)
    geometry = normalised(source(before, after, Path(gettempdir()), silent))
    with np.load(folder / "truth_instances.npz") as stored:
        keys = zip(stored["video"], stored["index"], strict=True)
        row = {(VIDEOS[v], int(i)): k for k, (v, i) in enumerate(keys)}
        instances = stored["instances"]
        kinds = {int(i): str(k) for i, k in zip(stored["id"], stored["kind"], strict=True)}
    return rendered_pair(
        geometry, tuple(_resized(instances[row[v.key]], v.shape) for v in geometry.views), kinds
    )


def rendered_pair(
    geometry: Geometry, instances: tuple[Int[np.ndarray, "h w"], ...], kinds: Mapping[int, str]
) -> RenderedPair:
    """The pair with its light made equal, as `change.scoring` does it."""
    visibility = VisibilityConfig()
    pairs = pair_views(geometry, visibility)
    equalised = harmonised(geometry, pairs, HarmoniseConfig(), visibility).geometry
    turns = [_turn(geometry.views[i], geometry.views[j]) for i, j in pairs]
    ordered = tuple(pairs[k] for k in np.argsort(turns, kind="stable"))
    return RenderedPair(geometry, equalised, instances, kinds, ordered)


def seen_objects(
    pair: RenderedPair, grids: Mapping[int, np.ndarray], video: Video
) -> dict[int, SceneObject]:
    """Every true object of a capture, as the views that `grids` has features of show it."""
    seen: dict[int, list[ChangedRegion]] = {}
    least = ObjectConfig().min_area
    for k, grid in grids.items():
        view, labels = pair.equalised.views[k], pair.instances[k].astype(np.int32)
        if view.video != video:
            continue
        descriptors = region_descriptors(grid, Regions(labels, int(labels.max()) + 1))
        points = unproject(view)
        for number in np.unique(labels[labels > 0]):
            mask = labels == number
            if np.count_nonzero(mask) < least * (max(view.shape) / 518) ** 2:
                continue
            cloud = points[mask]
            cloud = cloud[np.isfinite(cloud).all(axis=1)].astype(np.float64)
            region = ChangedRegion(
                k, int(number), mask, 0.0, TermScores(0.0, 0.0, 0.0), descriptors[number],
                cloud[:: max(len(cloud) // ObjectConfig().max_points, 1)],
            )  # fmt: skip
            seen.setdefault(int(number), []).append(region)
    return {number: SceneObject(video, tuple(regions)) for number, regions in seen.items()}


def neighbouring_regions(
    objects: Mapping[int, SceneObject],
) -> list[tuple[bool, ChangedRegion, ChangedRegion]]:
    """(same object?, region, region) for the regions of views that follow each other."""
    by_view: dict[int, list[ChangedRegion]] = {}
    for item in objects.values():
        for region in item.regions:
            by_view.setdefault(region.view, []).append(region)
    return [
        (a.label == b.label, a, b)
        for one, other in itertools.pairwise(sorted(by_view))
        for a, b in itertools.product(by_view[one], by_view[other])
    ]


def _turn(one: View, other: View) -> float:
    """Angle (radians) between two cameras as seen from the middle of what the first one shows."""
    middle = np.nanmedian(unproject(one).reshape(-1, 3), axis=0)
    rays = [camera_centre(v.cam_from_world) - middle for v in (one, other)]
    cosine = rays[0] @ rays[1] / (np.linalg.norm(rays[0]) * np.linalg.norm(rays[1]))
    return float(np.arccos(np.clip(cosine, -1, 1)))


def _resized(labels: Int[np.ndarray, "H W"], shape: tuple[int, int]) -> Int[np.ndarray, "h w"]:
    return cv2.resize(labels, shape[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
