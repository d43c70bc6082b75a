"""Things cut out of a grid of voxels: step 7 of 3DGS-CD (not used in the paper)."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64

from scenediff_classic.cameras import inside, project, unproject
from scenediff_classic.change.changed_regions import ChangedRegion
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.types import Geometry, View


@dataclass(frozen=True)
class OccupancyConfig:
    """The grid."""

    voxels: int = 48
    """Along the longest side of the box around the thing's points."""
    agreement: float = 0.95
    """A voxel is part of the thing if this share of the views that see it have it in their mask."""
    margin: float = 0.1
    """The box grows by this share at each side."""
    near: float = 0.02
    """In a view without a mask, surfaces this close (normalised units) to the thing hide
    nothing of it."""


def carved(
    thing: SceneObject, geometry: Geometry, views: list[int], config: OccupancyConfig
) -> SceneObject:
    """The thing with the masks of its occupied voxels, in all views in which it is not hidden.

    A thing of which nothing stays occupied is given back as it was.

    Parameters
    ----------
    views : list of int
        Positions of all views of the thing's capture.
    """
    if not len(thing.points):
        return thing
    centres, side = _grid(thing.points, config)
    seen, held = np.zeros(len(centres)), np.zeros(len(centres))
    for k, mask in _masks(thing).items():
        view = geometry.views[k]
        xy, _ = project(centres, view.intrinsics, view.cam_from_world)
        there = inside(xy, *view.shape)
        columns, rows = xy[there].astype(int).T
        seen += there
        held[there] += mask[rows, columns]
    solid = centres[(seen > 0) & (held >= config.agreement * seen)]
    if not len(solid):
        return thing
    first = max(thing.regions, key=lambda r: r.score)
    regions = []
    for k in views:
        region = _projected(k, geometry.views[k], solid, side, first, config)
        if region is not None:
            regions.append(region)
    return SceneObject(thing.video, tuple(regions)) if regions else thing


def _masks(thing: SceneObject) -> dict[int, np.ndarray]:
    out: dict[int, np.ndarray] = {}
    for r in thing.regions:
        out[r.view] = r.mask | out[r.view] if r.view in out else r.mask
    return out


def _grid(
    points: Float64[np.ndarray, "n 3"], config: OccupancyConfig
) -> tuple[Float64[np.ndarray, "m 3"], float]:
    low, high = points.min(axis=0), points.max(axis=0)
    room = config.margin * (high - low).max()
    low, high = low - room, high + room
    side = float((high - low).max()) / config.voxels
    side = max(side, float(np.finfo(np.float32).tiny))
    counts = np.maximum(np.ceil((high - low) / side).astype(int), 1)
    cells = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1)
    return low + (cells.reshape(-1, 3) + 0.5) * side, side


def _projected(
    k: int,
    view: View,
    solid: Float64[np.ndarray, "n 3"],
    side: float,
    like: ChangedRegion,
    config: OccupancyConfig,
) -> ChangedRegion | None:
    """The voxels' outline where the view's surfaces are not in front of them."""
    xy, z = project(solid, view.intrinsics, view.cam_from_world)
    there = inside(xy, *view.shape)
    if not there.any():
        return None
    mask = np.zeros(view.shape, np.uint8)
    columns, rows = xy[there].astype(int).T
    mask[rows, columns] = 1
    across = side * view.intrinsics[0, 0] / np.median(z[there])
    width = 2 * int(np.ceil(across / 2)) + 1
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((width, width), np.uint8))
    hidden = view.depth < z[there].min() - config.near
    shown = (mask > 0) & ~hidden & ~view.ignore
    if not shown.any():
        return None
    points = unproject(view)[shown]
    kept = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    return replace(like, view=k, mask=shown, points=kept)
