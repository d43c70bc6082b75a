"""Two views of a geometry as a pair for the networks, without truth."""

import cv2
import numpy as np

from baselines.cyws.pairs import TwoViews
from scenediff_classic.cameras import scale_intrinsics
from scenediff_classic.types import View


def two_views(a: View, b: View, height: int, width: int) -> TwoViews:
    """Pictures, depth and cameras of two views at the network's size; no boxes."""
    size = (width, height)
    images = [cv2.resize(v.image, size, interpolation=cv2.INTER_AREA) for v in (a, b)]
    depth = [cv2.resize(v.depth, size, interpolation=cv2.INTER_NEAREST) for v in (a, b)]
    lenses = [
        scale_intrinsics(v.intrinsics, width / v.shape[1], height / v.shape[0]) for v in (a, b)
    ]
    return TwoViews(
        np.stack(images),
        np.stack(depth),
        np.stack(lenses),
        np.stack([v.cam_from_world for v in (a, b)]),
        np.zeros((0, 2, 4), np.float32),
    )
