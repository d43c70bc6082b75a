"""The camera that Gaussians are rendered with."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from scenediff_classic.cameras import camera_centre, scale_intrinsics
from scenediff_classic.types import View

MARGIN = 0.15
"""Gaussians this share of the picture beyond its border are flattened as if they were on it: the
linear approximation of the projection is useless farther out."""


@dataclass(frozen=True)
class PinholeCamera:
    """A pinhole camera at a place (conventions as in `scenediff_classic.types`)."""

    intrinsics: Float64[np.ndarray, "3 3"]
    cam_from_world: Float64[np.ndarray, "4 4"]
    height: int
    width: int
    near: float = 1e-6
    """Gaussians whose centre is nearer than this (z-depth, world units) are not drawn."""

    @staticmethod
    def of(view: View, near: float = 1e-6) -> "PinholeCamera":
        """The camera of a registered frame."""
        return PinholeCamera(view.intrinsics, view.cam_from_world, *view.shape, near)

    def resized(self, height: int, width: int) -> "PinholeCamera":
        """The same camera with pictures of another size."""
        intrinsics = scale_intrinsics(self.intrinsics, width / self.width, height / self.height)
        return replace(self, intrinsics=intrinsics, height=height, width=width)

    def packed(self, dtype: type[np.floating]) -> np.ndarray:
        """All numbers that the projection needs, in the order that its kernels read them.

        Rotation (9), translation (3), fx, fy, skew, cx, cy, the range of x / z and of y / z within
        which the projection is linearised (4), near, the camera's centre (3).
        """
        K = self.intrinsics
        x = np.array([-MARGIN, 1 + MARGIN]) * self.width
        y = np.array([-MARGIN, 1 + MARGIN]) * self.height
        numbers = [
            *self.cam_from_world[:3, :3].ravel(), *self.cam_from_world[:3, 3],
            K[0, 0], K[1, 1], K[0, 1], K[0, 2], K[1, 2],
            *(x - K[0, 2]) / K[0, 0], *(y - K[1, 2]) / K[1, 1],
            self.near, *camera_centre(self.cam_from_world),
        ]  # fmt: skip
        return np.array(numbers, dtype)
