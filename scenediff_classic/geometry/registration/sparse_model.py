"""What goes into COLMAP and what comes out of it, as plain values."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float, Float64, Int64

from scenediff_classic.cameras import project, source_from_view
from scenediff_classic.types import Lens, SparsePoints

LOOKED_AT = 300
"""At most so many matches of a pair are looked at for its motion and parallax."""


@dataclass(frozen=True)
class Picture:
    """An image file as COLMAP sees it."""

    name: str
    """Path relative to the image folder, without spaces."""
    width: int
    height: int
    camera: int
    """Pictures of the same number share one camera; from 0."""
    focal: float | None
    """Prior focal length in pixels of this file; None = unknown."""


@dataclass(frozen=True)
class FeatureRecipe:
    """How features are found and matched."""

    name: str
    peak_threshold: float = 0.0067
    """Lowest contrast of a SIFT keypoint; COLMAP's default is 0.02 / 3."""
    ratio: float = 0.8
    """Largest distance ratio of the best to the second best match."""
    affine: bool = False
    """Estimate affine shape and pool descriptors over domain sizes: slower, more viewpoint."""
    guided: bool = False
    """Match again along the estimated epipolar geometry."""
    max_side: int = 1600
    """Larger pictures are searched at this long side."""
    weights: Path | None = None
    """Folder with the weights of ALIKED and LightGlue, to be used instead of SIFT."""


@dataclass(frozen=True)
class MapperRecipe:
    """How cameras and points are computed from matches."""

    name: str
    method: Literal["incremental", "global"] = "incremental"
    init_inliers: int = 100
    """Fewest matches of the first pair."""
    init_angle: float = 16.0
    """Smallest median triangulation angle of the first pair, in degrees."""
    pose_inliers: int = 30
    """Fewest 2D-3D matches that place a further picture."""
    two_view_points: bool = False
    """Also keep points that only two pictures see."""
    refine_lens: bool = True
    """Refine focal length and distortion; two pictures alone cannot carry that."""


@dataclass(frozen=True)
class PosedPicture:
    """A picture whose camera is known."""

    name: str
    lens: Lens
    cam_from_world: Float64[np.ndarray, "4 4"]


@dataclass(frozen=True)
class SparseModel:
    """A COLMAP reconstruction as plain values; pictures are sorted by name."""

    pictures: tuple[PosedPicture, ...]
    points: SparsePoints
    """Observations count positions in `pictures`."""
    error: float
    """Mean reprojection error in pixels; NaN without points."""
    keypoints: Float64[np.ndarray, "m 2"] | None = None
    """Where each observation was found in its picture, in pixels; None = not known."""
    features: Int64[np.ndarray, "m"] | None = None
    """Which feature of its picture each observation is, as in the database; None = not known."""


def project_points(
    xyz: Float64[np.ndarray, "n 3"], picture: PosedPicture
) -> Float64[np.ndarray, "n 2"]:
    """Pixels at which a picture sees world points, distortion included; NaN behind the camera."""
    xy, _ = project(xyz, picture.lens.intrinsics, picture.cam_from_world)
    return source_from_view(xy, picture.lens, picture.lens.intrinsics)


def residuals(model: SparseModel) -> Float64[np.ndarray, "m 2"]:
    """Reprojection error of each observation, in pixels; NaN if the point is behind the camera."""
    assert model.keypoints is not None
    errors = -model.keypoints
    point, picture = model.points.observations.T
    for number, posed in enumerate(model.pictures):
        here = picture == number
        errors[here] += project_points(model.points.xyz[point[here]], posed)
    return errors


def points_of_features(model: SparseModel) -> dict[str, dict[int, int]]:
    """For each picture of a model, by name: which point each of its features is."""
    assert model.features is not None
    found: dict[str, dict[int, int]] = {picture.name: {} for picture in model.pictures}
    for (point, picture), feature in zip(
        model.points.observations.tolist(), model.features.tolist(), strict=True
    ):
        found[model.pictures[picture].name][feature] = point
    return found


@dataclass(frozen=True)
class EpipolarPair:
    """Matches of two pictures and their fundamental matrix.

    Positions count from the pictures' middles, as shares of their longer sides.
    """

    cameras: tuple[int, int]
    first: Float64[np.ndarray, "n 2"]
    second: Float64[np.ndarray, "n 2"]
    fundamental: Float64[np.ndarray, "3 3"]
    pixel: float
    """One pixel in this unit: the larger one of the two pictures."""


@dataclass(frozen=True)
class FeatureMatches:
    """Verified matches of two pictures."""

    first: str
    second: str
    features: Int64[np.ndarray, "n 2"]
    """(feature of the first picture, feature of the second), as numbered in the database."""

    def swapped(self) -> "FeatureMatches":
        """The same, with the pictures' roles exchanged."""
        return FeatureMatches(self.second, self.first, self.features[:, ::-1])


@dataclass(frozen=True)
class PairMatch:
    """Two pictures and how many of their matches fit one epipolar geometry."""

    first: str
    second: str
    inliers: int
    shift: float
    """Median distance between matched keypoints, as a share of the longer side."""
    parallax: float
    """How far matches stray from the best homography: the 90th percentile of the distance, as a
    share of the longer side. Near 0 if the camera only turns, or sees one flat surface."""

    @staticmethod
    def measure(
        first: str,
        second: str,
        xy_first: Float[np.ndarray, "n 2"],
        xy_second: Float[np.ndarray, "n 2"],
    ) -> "PairMatch":
        """Measure matched positions, given as shares of each picture's longer side."""
        count = len(xy_first)
        keep = np.linspace(0, count - 1, min(count, LOOKED_AT)).astype(int)
        a, b = xy_first[keep].astype(np.float64), xy_second[keep].astype(np.float64)
        shift = float(np.median(np.linalg.norm(b - a, axis=1)))
        # judged with room for noise: more rounds would only find the same plane again
        homography = (
            cv2.findHomography(a, b, cv2.RANSAC, 0.002, maxIters=200)[0] if count >= 4 else None
        )
        if homography is None:
            return PairMatch(first, second, count, shift, 0.0)
        mapped = cv2.perspectiveTransform(a[None], homography)[0]
        stray = np.percentile(np.linalg.norm(mapped - b, axis=1), 90)
        return PairMatch(first, second, count, shift, float(stray))
