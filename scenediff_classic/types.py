"""Every value that one stage hands to the next.

Conventions, kept everywhere in the project:

* images are RGB, ``uint8``, rows first;
* pixel ``(0, 0)`` covers ``[0, 1) x [0, 1)``: its centre is at ``(0.5, 0.5)``, as in COLMAP;
* ``cam_from_world`` is a 4x4 rigid transform; the camera looks along +z, x right, y down;
* ``depth`` is z-depth in the world's unit; NaN means unknown.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int32, Int64, UInt8

Video = Literal["before", "after"]
Kind = Literal["added", "removed", "moved"]

VIDEOS: tuple[Video, Video] = ("before", "after")


@dataclass(frozen=True)
class Frame:
    """One sampled picture of a capture, upright (all rotation already applied)."""

    video: Video
    index: int
    """Position among the capture's sampled frames, from 0."""
    name: str
    """File name, or ``<video stem>#<index>`` for a video frame."""
    time_s: float | None
    """Presentation time in a video; None for a photo."""
    image: UInt8[np.ndarray, "h w 3"]
    """Pixels, possibly smaller than the input (see `width`, `height`)."""
    width: int
    """Width of the input picture, in pixels."""
    height: int
    focal_px: float | None = None
    """Focal length from EXIF, in pixels of the *input* picture."""
    ignore: Bool[np.ndarray, "h w"] | None = None
    """True where the picture shows dynamic content that is no part of the scene."""


@dataclass(frozen=True)
class Capture:
    """All sampled frames of one video, one photo folder or one photo."""

    video: Video
    source: str
    frames: tuple[Frame, ...]
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Lens:
    """The camera of an *input* picture: OpenCV's radial-tangential model."""

    width: int
    height: int
    intrinsics: Float64[np.ndarray, "3 3"]
    distortion: Float64[np.ndarray, "4"]
    """(k1, k2, p1, p2)."""


@dataclass(frozen=True)
class Placement:
    """How firmly structure from motion placed a frame among the others."""

    confidence: float
    """Trust in the camera, 0 to 1: from the figures below (see `geometry.placement`)."""
    points: int
    """Points of the sparse model that the frame observes."""
    shared: int
    """Those among them that the other capture observes as well: the inliers of the alignment."""
    cover: float
    """Share of the picture's 4 x 4 cells that hold one of its points."""
    error_px: float
    """Mean reprojection error of its points, in pixels of the picture in which they were found."""
    agreement: float | None = None
    """Share of its matches with its own capture that fit its camera; None = too few to say."""


@dataclass(frozen=True)
class View:
    """A registered frame: undistorted picture at working size, camera, depth."""

    video: Video
    index: int
    name: str
    image: UInt8[np.ndarray, "h w 3"]
    intrinsics: Float64[np.ndarray, "3 3"]
    cam_from_world: Float64[np.ndarray, "4 4"]
    depth: Float32[np.ndarray, "h w"]
    """z-depth; NaN = unknown."""
    confidence: Float32[np.ndarray, "h w"]
    """Trust in `depth`, 0 to 1."""
    measured: Bool[np.ndarray, "h w"]
    """True where `depth` was measured; finite depth elsewhere is a completion (a guess)."""
    ignore: Bool[np.ndarray, "h w"]
    """True for dynamic content and for pixels outside the input picture."""
    lens: Lens
    placement: Placement | None = None
    """None where the camera was given, not found."""

    @property
    def key(self) -> tuple[Video, int]:
        """(video, frame index): unique within a geometry."""
        return self.video, self.index

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the working picture."""
        return self.image.shape[0], self.image.shape[1]


@dataclass(frozen=True)
class SparsePoints:
    """Triangulated SfM points and the views that observe them."""

    xyz: Float64[np.ndarray, "n 3"]
    rgb: UInt8[np.ndarray, "n 3"]
    observations: Int64[np.ndarray, "m 2"]
    """Rows (point, position in `Geometry.views`)."""

    @staticmethod
    def none() -> "SparsePoints":
        """No points: for geometry that came without any."""
        return SparsePoints(
            np.zeros((0, 3)), np.zeros((0, 3), np.uint8), np.zeros((0, 2), np.int64)
        )


@dataclass(frozen=True)
class Unregistered:
    """A frame left out of the geometry, and why."""

    video: Video
    index: int
    reason: str


@dataclass(frozen=True)
class Geometry:
    """Both captures in one world frame."""

    views: tuple[View, ...]
    points: SparsePoints
    unregistered: tuple[Unregistered, ...] = ()
    warnings: tuple[str, ...] = ()
    log: tuple[str, ...] = ()
    """What was tried, in order, and how it went: one sentence each."""
    unit: float = 1.0
    """World length of one unit here: multiply lengths by it to get back to the source's world."""
    bridge: int | None = None
    """Points seen from both captures: what aligns them. None where cameras were given."""

    def of(self, video: Video) -> tuple[View, ...]:
        """The views of one capture, by frame index."""
        return tuple(v for v in self.views if v.video == video)


@dataclass(frozen=True)
class Regions:
    """Non-overlapping object-like regions of one view."""

    labels: Int32[np.ndarray, "h w"]
    """0 to count - 1; -1 where no region is."""
    count: int


@dataclass(frozen=True)
class ScoreMaps:
    """Change evidence of one view, at working size; NaN = no view pair could tell."""

    geometry: Float32[np.ndarray, "h w"]
    feature: Float32[np.ndarray, "h w"]
    region: Float32[np.ndarray, "h w"]
    total: Float32[np.ndarray, "h w"]
    """Pooled over regions: the score that is thresholded."""


@dataclass(frozen=True)
class Rle:
    """COCO compressed run-length mask (column-major)."""

    size: tuple[int, int]
    """(height, width)."""
    counts: str


@dataclass(frozen=True)
class ObjectView:
    """A changed object in one frame; the mask is at the input's resolution."""

    video: Video
    frame: int
    confidence: float
    bbox: tuple[float, float, float, float]
    """x, y, width, height, in input pixels."""
    mask: Rle


@dataclass(frozen=True)
class TermScores:
    """The three terms of the change score, each averaged over the object's regions."""

    geometry: float
    feature: float
    region: float


@dataclass(frozen=True)
class PairScore:
    """How changed an object looks when one frame that shows it is compared with one of the other
    capture alone."""

    video: Video
    """The capture that shows the object."""
    frame: int
    other: int
    """Frame of the other capture."""
    score: float


@dataclass(frozen=True)
class Support:
    """The comparisons of two frames behind an object."""

    compared: int
    """Pairs of frames in which both could see the object's place."""
    above: int
    """Those in which its score passes the threshold."""
    strongest: tuple[PairScore, ...]
    """A few with the highest scores."""


@dataclass(frozen=True)
class Match:
    """How the likeliest counterpart in the other capture was judged: alike and of similar size
    means moved."""

    similarity: float
    """Cosine of the descriptors."""
    least: float
    """Similarity from which on it counts as the same thing."""
    size_ratio: float
    """The larger of the two sizes over the smaller one; 0 = unknown."""
    most: float
    """Largest ratio for the same thing; 0 = sizes are not compared."""


DOUBTFUL = 0.2
"""Confidence below which a changed object is called doubtful."""


@dataclass(frozen=True)
class ChangedObject:
    """One changed object, with one identity over all views."""

    id: int
    kind: Kind
    confidence: float
    centroid_before: tuple[float, float, float] | None
    centroid_after: tuple[float, float, float] | None
    extent_before: tuple[float, float, float] | None
    """Axis-aligned size in the world frame (5 to 95 percentile of the points)."""
    extent_after: tuple[float, float, float] | None
    scores: TermScores
    views: tuple[ObjectView, ...]
    support: Support | None = None
    """None where a method does not compare pairs of frames."""
    match: Match | None = None
    """None where the other capture has no changed object at all."""

    @property
    def doubtful(self) -> bool:
        """True if its confidence is low: to be looked at, not to be relied on."""
        return self.confidence < DOUBTFUL


@dataclass(frozen=True)
class FrameInfo:
    """What `changes.json` says of a sampled frame."""

    index: int
    name: str
    time_s: float | None
    width: int
    height: int
    registered: bool
    reason: str | None
    placement: Placement | None = None
    """None for a frame that was left out, and where cameras were given."""


@dataclass(frozen=True)
class VideoInfo:
    """A capture without its pixels."""

    source: str
    frames: tuple[FrameInfo, ...]


@dataclass(frozen=True)
class ChangeResult:
    """What a change detector answers; everything that `changes.json` holds."""

    before: VideoInfo
    after: VideoInfo
    objects: tuple[ChangedObject, ...]
    threshold: float | None
    """Score above which a region counts as changed; None = nothing stood out of the noise."""
    scale: float
    """World length of one normalised unit (see `Geometry.unit`)."""
    warnings: tuple[str, ...] = ()
    bridge: int | None = None
    """See `Geometry.bridge`."""


@dataclass(frozen=True)
class Comparison:
    """A captured picture, and what a model of the other capture shows from the same camera."""

    view: int
    """Position in the geometry's views."""
    captured: UInt8[np.ndarray, "h w 3"]
    """As it was compared: its size and colours may not be the view's."""
    rendered: UInt8[np.ndarray, "h w 3"]
    difference: Float32[np.ndarray, "h w"]
    """From 0 (none) to 1; NaN where the model knows nothing."""
    found: Bool[np.ndarray, "h w"]


@dataclass(frozen=True)
class Evidence:
    """What the report shows beside the result; not part of the output contract."""

    geometry: Geometry
    scores: tuple[ScoreMaps, ...]
    """Same order as `geometry.views`."""
    pairs: tuple[tuple[int, int], ...]
    """Positions in `geometry.views` of the (before, after) views that were compared."""
    stage_seconds: dict[str, float] = field(default_factory=dict)
    comparisons: tuple[Comparison, ...] = ()
    """Of methods that compare pictures with renders."""
    files: Mapping[str, str] = field(default_factory=dict)
    """Name -> text of further files that a method leaves in the output folder."""


PointCloud = Float[np.ndarray, "n 3"]
