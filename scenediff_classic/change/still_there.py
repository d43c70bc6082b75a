"""Things that only look different because the light does (not in the paper).

Light that comes from elsewhere changes the look of a thing more than any gain of the whole picture
explains: shading, highlights, colours near white. Where the other capture measures the very same
surface at the very same place, nothing was added, removed or moved, whatever it looks like.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from scenediff_classic.cameras import project, sample, unproject
from scenediff_classic.change.changed_regions import ChangedRegion, every
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.types import Geometry, View

LIGHT_WARNING = (
    "The light differs between the captures: what only looks different, at a place where both "
    "measure the same surface, is not reported."
)


@dataclass(frozen=True)
class StillThereConfig:
    """When a thing that looks different is the same."""

    light: float = 0.09
    """Difference of light (`harmonise.Harmonised.light`) from which on looks alone prove nothing.
    Rendered val and sparse pairs: 0.012 to 0.072 in the same light, 0.116 and more in another."""
    share: float = 0.3
    """Share of a thing's points that must be measured again. Rendered val and sparse pairs: up to
    0.16 for true changes (0.36 for one in a room of low texture); 0.40 to 0.92 for things that only
    look different in another light. Above 1 turns this off."""
    tolerance: float = 0.01
    """Difference of depth, relative to it, up to which a surface is the same."""

    def applies(self, light: float) -> bool:
        """Whether the light differs so much, and the rule is not turned off."""
        return light > self.light and self.share <= 1


def without_still_there(
    objects: Sequence[SceneObject], geometry: Geometry, light: float, config: StillThereConfig
) -> list[SceneObject]:
    """Only things that the other capture does not measure at the same place, if the light differs.

    Parameters
    ----------
    light : float
        `scoring.Scores.light`.
    """
    if not config.applies(light):
        return list(objects)
    return [o for o in objects if measured_again(o, geometry, config.tolerance) < config.share]


def measured_again(item: SceneObject, geometry: Geometry, tolerance: float) -> float:
    """Share of a thing's measured points that views of the other capture measure where they are.

    Out of those that they either measure there or see through; what is hidden from a view, or
    unmeasured in it, says nothing. 0 if nothing says anything.
    """
    points = np.concatenate([_measured_points(r, geometry.views[r.view]) for r in item.regions])
    same = through = 0
    for view in geometry.views:
        if view.video == item.video or len(points) == 0:
            continue
        xy, z = project(points, view.intrinsics, view.cam_from_world)
        measured = np.where(view.measured, view.depth, np.nan)
        depth = sample(measured, xy[None], nearest=True)[0]
        with np.errstate(invalid="ignore", divide="ignore"):
            behind = np.where(z > 0, (depth - z) / z, np.nan)  # NaN compares as False
        same += int((np.abs(behind) < tolerance).sum())
        through += int((behind >= tolerance).sum())
    return same / max(same + through, 1)


def _measured_points(region: ChangedRegion, view: View) -> Float64[np.ndarray, "n 3"]:
    """Some 200 points: completed depth is that of the neighbourhood, not of the thing."""
    points = unproject(view)[region.mask & view.measured]
    return every(points[np.isfinite(points).all(axis=1)].astype(np.float64), 200)
