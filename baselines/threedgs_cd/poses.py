"""How a thing moved: steps 5 and 6 of 3DGS-CD."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float64, UInt8

from scenediff_classic.cameras import sample, unproject, world_from_cam
from scenediff_classic.types import View


@dataclass(frozen=True)
class PoseConfig:
    """When a thing that is gone was found again."""

    error: float = 0.012
    """Largest reprojection error, as a share of the picture's width: the published 12 pixels for a
    picture about a thousand wide."""
    inliers: int = 4
    """Fewer are no support."""
    alike: float = 0.8
    """Least cosine of the descriptors of what is gone and what was found; belongs to the features:
    four keypoints may agree by chance. 0 = none, as published."""
    ratio: float = 0.85
    """Of the distances to the best and to the second best descriptor."""
    enlarge: int = 3
    """Keypoints are sought in pictures this many times larger: things are small."""
    still: float = 0.01
    """A thing whose points move less (normalised units) stands where it stood, and is no change;
    0 = none, as published."""


@dataclass(frozen=True)
class Keypoints:
    """SIFT keypoints of some pixels."""

    xy: Float64[np.ndarray, "n 2"]
    descriptors: np.ndarray
    """(n, 128) float32."""


@dataclass(frozen=True)
class Template:
    """Keypoints of a thing in a render, with their places in space."""

    keypoints: Keypoints
    points: Float64[np.ndarray, "n 3"]


@dataclass(frozen=True)
class Motion:
    """How a thing moved."""

    transform: Float64[np.ndarray, "4 4"]
    """Takes points of the thing from where it was to where it is, in the world frame."""
    view: int
    """Position of the view in which most keypoints agree."""
    inliers: int

    def __call__(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        """The points after the motion."""
        return points @ self.transform[:3, :3].T + self.transform[:3, 3]


def keypoints(
    image: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"], config: PoseConfig
) -> Keypoints:
    """SIFT where the mask is."""
    none = Keypoints(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return none
    pad = 8
    top, left = max(rows.min() - pad, 0), max(columns.min() - pad, 0)
    part = np.s_[top : rows.max() + pad + 1, left : columns.max() + pad + 1]
    grey = cv2.cvtColor(image[part], cv2.COLOR_RGB2GRAY)
    size = (grey.shape[1] * config.enlarge, grey.shape[0] * config.enlarge)
    large = cv2.resize(grey, size, interpolation=cv2.INTER_CUBIC)
    where = cv2.resize(mask[part].astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    found, descriptors = cv2.SIFT.create(contrastThreshold=0.02).detectAndCompute(large, where)
    if descriptors is None or not len(found):
        return none
    # OpenCV counts from the centre of the first pixel
    xy = (np.array([k.pt for k in found]) + 0.5) / config.enlarge + [left, top]
    return Keypoints(xy, descriptors)


def template(found: Keypoints, view: View) -> Template:
    """Keypoints with their places, by the depth of the view; those without depth are left out."""
    points = sample(unproject(view), found.xy[None], nearest=True)[0].astype(np.float64)
    known = np.isfinite(points).all(axis=1)
    return Template(
        Keypoints(found.xy[known], found.descriptors[known]), points[known].reshape(-1, 3)
    )


def motion(
    templates: Sequence[Template],
    candidates: Sequence[tuple[int, View, Keypoints]],
    config: PoseConfig,
) -> Motion | None:
    """The motion that explains most keypoints in one view; None if none explains enough.

    Parameters
    ----------
    templates : sequence of Template
        The thing as several renders show it.
    candidates : sequence of (position, View, Keypoints)
        Where pictures differ from renders.
    """
    best: Motion | None = None
    for k, view, found in candidates:
        for one in templates:
            answer = _solved(one, found, view, config)
            if answer is not None and (best is None or answer[1] > best.inliers):
                best = Motion(answer[0], k, answer[1])
    return best


def _solved(
    thing: Template, found: Keypoints, view: View, config: PoseConfig
) -> tuple[Float64[np.ndarray, "4 4"], int] | None:
    if len(thing.points) < config.inliers or len(found.xy) < config.inliers:
        return None
    nearest = cv2.BFMatcher(cv2.NORM_L2).knnMatch(
        thing.keypoints.descriptors, found.descriptors, k=2
    )
    pairs = [
        (m[0].queryIdx, m[0].trainIdx)
        for m in nearest
        if len(m) == 2 and m[0].distance < config.ratio * m[1].distance
    ]
    if len(pairs) < config.inliers:
        return None
    there, here = np.array(pairs).T
    cv2.setRNGSeed(0)
    solved, turn, shift, kept = cv2.solvePnPRansac(
        thing.points[there], found.xy[here], view.intrinsics, None,
        reprojectionError=config.error * view.shape[1], iterationsCount=300, confidence=0.999,
        flags=cv2.SOLVEPNP_EPNP,
    )  # fmt: skip
    # one keypoint that was found twice is no support
    distinct = 0 if kept is None else len(np.unique(thing.points[there[kept.ravel()]], axis=0))
    if not solved or distinct < config.inliers:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    transform = world_from_cam(view.cam_from_world) @ pose
    return (transform, distinct) if np.isfinite(transform).all() else None
