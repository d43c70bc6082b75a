"""Which other views help to find the depth of a view, and how far away things may be."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Float64

from scenediff_classic.cameras import camera_centre, inside, project, world_from_cam
from scenediff_classic.types import Geometry, View

BEST_ANGLES_DEG = (5.0, 15.0)
"""Triangulation angles that neither blur the depth nor change how a surface looks."""

_FRUSTUM_SHARE = 0.2
"""Weight of a point that a source should see but has no observation of."""


def inverse_depth_range(
    view: View, points: Float64[np.ndarray, "n 3"], others: Sequence[View], margin: float
) -> tuple[float, float]:
    """Smallest and largest inverse depth to search, in 1 / world unit.

    Parameters
    ----------
    points : array (n, 3)
        World points that the view observes. With fewer than 8, the range follows from the
        parallax: from one pixel to half the picture's width over the median baseline.
    margin : float
        Factor by which the range of the points is widened at either end.
    """
    depth = project(points, view.intrinsics, view.cam_from_world)[1]
    depth = depth[depth > 0]
    if len(depth) >= 8:
        near, far = np.percentile(depth, [1, 99])
        return 1 / (far * margin), margin / near
    one_pixel = 1 / (view.intrinsics[0, 0] * median_baseline(view, others))
    return one_pixel, one_pixel * view.shape[1] / 2


def median_baseline(view: View, others: Sequence[View]) -> float:
    """Median distance between the view's camera and the others that are not at its place."""
    centre = camera_centre(view.cam_from_world)
    lengths = [float(np.linalg.norm(camera_centre(o.cam_from_world) - centre)) for o in others]
    apart = [length for length in lengths if length > 1e-9]
    return float(np.median(apart)) if apart else 1.0


def observed_points(geometry: Geometry) -> Bool[np.ndarray, "views points"]:
    """True where a view observes a sparse point."""
    seen = np.zeros((len(geometry.views), len(geometry.points.xyz)), bool)
    seen[geometry.points.observations[:, 1], geometry.points.observations[:, 0]] = True
    return seen


def select_sources(
    geometry: Geometry, position: int, *, count: int, enough: int, borrowed: int
) -> tuple[int, ...]:
    """Positions of the best source views for the view at `position`, best first.

    Sources are of the view's own video, so that a change between the captures cannot corrupt its
    depth. Only where it has too few other views does the other video help; its views come last.
    Ranked by how many points both see, each weighted by its triangulation angle; without sparse
    points, by the part of the view's frustum that both see.

    Parameters
    ----------
    count : int
        Most sources of the view's own video.
    enough : int
        With so many other views in its own video, none is borrowed from the other one.
    borrowed : int
        Most sources of the other video.
    """
    view = geometry.views[position]
    own = {i for i, v in enumerate(geometry.views) if v.video == view.video} - {position}
    candidates = own if len(own) >= enough else set(range(len(geometry.views))) - {position}
    seen = observed_points(geometry)
    shared = geometry.points.xyz[seen[position]]
    if len(shared) < 8:
        others = [geometry.views[i] for i in sorted(candidates)]
        shared = _frustum_points(view, *inverse_depth_range(view, shared, others, 1.0))
        seen = np.zeros((len(geometry.views), len(shared)), bool)
    else:
        seen = seen[:, seen[position]]
    scores = {i: _score(view, geometry.views[i], shared, seen[i]) for i in candidates}
    least = 1e-6 * len(shared)  # no parallax, nothing to measure
    useful = [i for i in candidates if scores[i] > least]
    ranked = sorted(useful, key=lambda i: (-scores[i], i))
    helpers = [i for i in ranked if i not in own]
    return (*[i for i in ranked if i in own][:count], *helpers[:borrowed])


def angle_weight(degrees: Float[np.ndarray, "n"]) -> Float64[np.ndarray, "n"]:
    """1 for `BEST_ANGLES_DEG`; falls to 0 at no parallax, and to nearly 0 by 45 degrees."""
    low, high = BEST_ANGLES_DEG
    above = np.exp(-0.5 * ((np.maximum(degrees, high) - high) / 10.0) ** 2)
    return np.minimum(degrees / low, 1.0) ** 2 * above


def _score(
    view: View, other: View, points: Float64[np.ndarray, "n 3"], seen: Bool[np.ndarray, "n"]
) -> float:
    """Angle-weighted number of points that both views see."""
    xy, _ = project(points, other.intrinsics, other.cam_from_world)
    share = np.where(seen, 1.0, np.where(inside(xy, *other.shape), _FRUSTUM_SHARE, 0.0))
    to_view = camera_centre(view.cam_from_world) - points
    to_other = camera_centre(other.cam_from_world) - points
    lengths = np.linalg.norm(to_view, axis=1) * np.linalg.norm(to_other, axis=1)
    cosine = np.sum(to_view * to_other, axis=1) / np.maximum(lengths, 1e-30)
    angles = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return float(np.sum(share * angle_weight(angles)))


def _frustum_points(view: View, w_min: float, w_max: float) -> Float64[np.ndarray, "n 3"]:
    """World points that fill a view's frustum, evenly in the picture and in inverse depth."""
    height, width = view.shape
    x, y = np.meshgrid((np.arange(6) + 0.5) / 6 * width, (np.arange(6) + 0.5) / 6 * height)
    rays = np.linalg.solve(view.intrinsics, np.stack([x.ravel(), y.ravel(), np.ones(36)])).T
    depths = 1 / np.linspace(w_min, w_max, 10)[1:]
    in_cam = (rays[None] * depths[:, None, None]).reshape(-1, 3)
    to_world = world_from_cam(view.cam_from_world)
    return in_cam @ to_world[:3, :3].T + to_world[:3, 3]
