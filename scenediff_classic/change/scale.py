"""One unit of length for every scene, whatever the reconstruction's own scale."""

from dataclasses import replace

import numpy as np

from scenediff_classic.cameras import unproject
from scenediff_classic.errors import AlignmentError
from scenediff_classic.types import Geometry, SparsePoints


def normalised(geometry: Geometry) -> Geometry:
    """The same geometry in a world where the scene's extent is 1.

    The extent is the largest side of the box between the 1st and the 99th percentile of all
    measured points of both captures; every threshold of the method is meant in this unit.

    Raises
    ------
    AlignmentError
        If no view has any measured depth.
    """
    points = [unproject(v)[::4, ::4][v.measured[::4, ::4]] for v in geometry.views]
    pooled = np.concatenate(points) if points else np.zeros((0, 3))
    pooled = pooled[np.isfinite(pooled).all(axis=1)]
    if len(pooled) < 100:
        raise AlignmentError(
            "No depth could be measured in either capture: take more pictures, from positions "
            "that differ by a step or two and that all show the same textured surfaces."
        )
    low, high = np.percentile(pooled, [1, 99], axis=0)
    return rescaled(geometry, float((high - low).max()))


def rescaled(geometry: Geometry, unit: float) -> Geometry:
    """The same geometry with lengths counted in multiples of `unit`."""

    def smaller(cam_from_world: np.ndarray) -> np.ndarray:
        out = cam_from_world.copy()
        out[:3, 3] /= unit
        return out

    views = tuple(
        replace(
            v,
            depth=(v.depth / np.float32(unit)).astype(np.float32),
            cam_from_world=smaller(v.cam_from_world),
        )
        for v in geometry.views
    )
    points = SparsePoints(
        geometry.points.xyz / unit, geometry.points.rgb, geometry.points.observations
    )
    return replace(geometry, views=views, points=points, unit=geometry.unit * unit)
