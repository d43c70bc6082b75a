"""Judging a joint reconstruction: is it good enough, which is best, and why did it fail."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float64, Int64

from scenediff_classic.cameras import camera_centre
from scenediff_classic.geometry.registration.sparse_model import PairMatch, SparseModel
from scenediff_classic.types import VIDEOS, SparsePoints, Video

MIN_BRIDGE = 12
"""Points seen by both captures without which they do not count as aligned."""
MIN_OVERLAP = 0.1
"""Some frame of each capture must share this much of its points with the other capture. Lenient
matching finds a few dozen repeated patterns between different rooms, one point in a hundred of
what the frames see (0.01 to 0.04 measured); captures of one place share more than 0.6."""
FEW_BRIDGE = 50
"""Below this many such points, the user is warned."""
MIN_ANGLE = 1.0
"""Median triangulation angle (degrees) below which there is no usable parallax."""
MAX_ERROR = 2.0
"""Largest mean reprojection error (pixels) of a sound model."""
MIN_SUPPORT = 12
"""Points without which a picture's camera is a guess; such a picture counts as unregistered."""
MIN_AGREEMENT = 0.5
"""Share of its own capture's matches that a camera must fit, or it stands against them (see
`agreement`). Lowest of a model's photos, measured on PASLCD: right ones 0.78 to 0.99 (0.55 after
guided matching), wrong ones 0.23 and 0.34 (0.16 and 0.03)."""
FOCAL_RANGE = (0.25, 6.0)
"""Sane focal lengths, as a multiple of the picture's longer side."""
MIN_FEATURES = 40
"""A picture with fewer features can hardly be placed."""
STILL = 0.002
"""Median motion of matches (share of the longer side) below which a camera stands still."""
MIN_PARALLAX = 0.003
"""Parallax that at least one pair needs. Less is explained as well by a camera that only turns;
mapping then invents a motion, and a focal length and distortion to go with it."""
MIN_ACROSS = 30
"""Verified matches of the best pair across the captures, below which they show different places.
Measured with two recipes: 20 at most between different places, 121 and more where a later rung
succeeds."""


def video_of(name: str) -> Video:
    """Capture of a picture, told from its name: ``before/00000.png``."""
    return VIDEOS[name.split("/", 1)[0] == "after"]


@dataclass(frozen=True)
class Quality:
    """What is good and bad about a model."""

    registered: dict[Video, int]
    total: dict[Video, int]
    points: int
    bridge: int
    """Points seen from both captures."""
    overlap: float
    """Share of its points that a frame has in common with the other capture: that of the best
    frame, in the capture where it is smaller."""
    error: float
    angle: float
    """Median over points of the largest angle between two of their rays, in degrees."""
    sane: bool
    """Focal lengths are plausible and the error is small."""
    opposed: dict[Video, int] = field(default_factory=lambda: dict.fromkeys(VIDEOS, 0))
    """How many of the registered frames stand against their own capture's matches."""

    @property
    def aligned(self) -> bool:
        """True if both captures are in one sound model."""
        enough = self.sane and self.angle >= MIN_ANGLE
        joined = self.bridge >= MIN_BRIDGE and self.overlap >= MIN_OVERLAP
        return enough and min(self.registered.values()) > 0 and joined

    @property
    def complete(self) -> bool:
        """Good enough to stop trying: aligned, with nearly all frames of both captures.

        Frames that stand against their matches do not count: more lenient matching may place them
        right. Few among many are left to the warning, since each further attempt takes minutes.
        """
        share = min((self.registered[v] - self.opposed[v]) / self.total[v] for v in VIDEOS)
        return self.aligned and share >= 0.9 and self.bridge >= FEW_BRIDGE

    @property
    def rank(self) -> tuple[float, ...]:
        """Sorts models from worst to best."""
        opposed = sum(self.opposed.values())
        placed = sum(self.registered.values()) - opposed
        return (self.aligned, placed, -opposed, min(self.bridge, 500), -self.error)

    def __str__(self) -> str:
        """One clause for the log."""
        counts = ", ".join(f"{v} {self.registered[v]} of {self.total[v]}" for v in VIDEOS)
        opposed = sum(self.opposed.values())
        oddity = f", {opposed} of them against their matches" if opposed else ""
        oddity += "" if self.sane else ", implausible cameras"
        return (
            f"{counts} frames registered, {self.points} points ({self.bridge} seen by both, "
            f"{self.overlap:.0%} of the best frame's), "
            f"reprojection error {self.error:.2f} px, ray angle {self.angle:.1f} degrees{oddity}"
        )


def usable_frames(features: Mapping[str, int]) -> dict[Video, int]:
    """How many frames of each capture have enough features to be placed; at least 1."""
    counts = Counter(video_of(name) for name, n in features.items() if n >= MIN_FEATURES)
    return {v: max(counts[v], 1) for v in VIDEOS}


def support(model: SparseModel) -> Int64[np.ndarray, "n"]:
    """How many points each picture observes."""
    return np.bincount(model.points.observations[:, 1], minlength=len(model.pictures))


def judge(
    model: SparseModel, total: Mapping[Video, int], shares: Mapping[str, float] | None = None
) -> Quality:
    """Measure a model against the number of frames of each capture that could be placed.

    Parameters
    ----------
    shares : mapping, optional
        Share of its matches that a picture's camera fits, by name, where it is known: see
        `agreement`.
    """
    carried = support(model) >= MIN_SUPPORT
    shares = shares or {}
    opposed = Counter(
        video_of(p.name)
        for p, enough in zip(model.pictures, carried, strict=True)
        if enough and shares.get(p.name, 1.0) < MIN_AGREEMENT
    )
    registered = Counter(
        video_of(p.name) for p, enough in zip(model.pictures, carried, strict=True) if enough
    )
    after = np.array([video_of(p.name) == "after" for p in model.pictures], bool)
    point, picture = model.points.observations.T
    both = bridging(model)
    shared = np.bincount(picture[both[point]], minlength=len(after)) / np.maximum(support(model), 1)
    focal = [p.lens.intrinsics[0, 0] / max(p.lens.width, p.lens.height) for p in model.pictures]
    plausible = all(FOCAL_RANGE[0] <= f <= FOCAL_RANGE[1] for f in focal)
    return Quality(
        registered={v: registered[v] for v in VIDEOS},
        total=dict(total),
        points=len(model.points.xyz),
        bridge=int(both.sum()),
        overlap=min(float(shared[carried & (after == side)].max(initial=0)) for side in (0, 1)),
        error=model.error,
        angle=ray_angle([camera_centre(p.cam_from_world) for p in model.pictures], model.points),
        sane=plausible and model.error <= MAX_ERROR,
        opposed={v: opposed[v] for v in VIDEOS},
    )


def ray_angle(centres: Sequence[Float64[np.ndarray, "3"]], points: SparsePoints) -> float:
    """Median over points of the widest angle between the rays that see them, in degrees."""
    if len(points.observations) == 0:
        return 0.0
    order = np.argsort(points.observations[:, 0], kind="stable")
    point, picture = points.observations[order].T
    rays = np.asarray(centres)[picture] - points.xyz[point]
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-300)
    starts = np.flatnonzero(np.r_[True, point[1:] != point[:-1]])
    widest = [(g @ g.T).min() for g in np.split(rays, starts[1:])]
    return float(np.degrees(np.median(np.arccos(np.clip(widest, -1, 1)))))


def bridging(model: SparseModel) -> Bool[np.ndarray, "n"]:
    """True for the points that both captures observe."""
    after = np.array([video_of(p.name) == "after" for p in model.pictures], bool)
    point, picture = model.points.observations.T
    seen = np.zeros((len(model.points.xyz), 2), bool)
    seen[point, after[picture].astype(int)] = True
    return seen[:, 0] & seen[:, 1]


def weak_pictures(model: SparseModel) -> dict[str, int]:
    """Pictures that were placed by too few points, and by how many."""
    return {
        picture.name: int(count)
        for picture, count in zip(model.pictures, support(model), strict=True)
        if count < MIN_SUPPORT
    }


def frame_reason(
    name: str,
    features: Mapping[str, int],
    pairs: Sequence[PairMatch],
    weak: Mapping[str, int],
) -> str:
    """Why a picture was left out, as one plain clause."""
    if name in weak:
        return f"its camera rests on only {weak[name]} points"
    if features[name] < MIN_FEATURES:
        return f"only {features[name]} features found (dark, blurred or without texture)"
    if not any(name in (pair.first, pair.second) for pair in pairs):
        return "nothing in it matches another frame"
    return "its matches do not agree with the other cameras"


def has_parallax(pairs: Sequence[PairMatch]) -> bool:
    """True if some pair of pictures cannot be explained by a camera that only turns."""
    return any(p.parallax >= MIN_PARALLAX for p in pairs if p.inliers >= 30)


def has_support(pairs: Sequence[PairMatch]) -> bool:
    """True if some pair across the captures has more matches than repeated patterns give."""
    across = (p for p in pairs if video_of(p.first) != video_of(p.second))
    return any(p.inliers >= MIN_ACROSS for p in across)


def few_points_warning(quality: Quality) -> tuple[str, ...]:
    """A sentence if few points hold the captures together, else nothing."""
    if quality.bridge >= FEW_BRIDGE:
        return ()
    return (
        f"Before and after hang together by only {quality.bridge} points: "
        "their alignment may be inaccurate.",
    )


def failure(
    qualities: Sequence[Quality], features: Mapping[str, int], pairs: Sequence[PairMatch]
) -> str:
    """Why before and after could not be aligned, and what to do: one sentence."""
    for video in VIDEOS:
        counts = [n for name, n in features.items() if video_of(name) == video]
        if max(counts) < MIN_FEATURES:
            return (
                f"no frame of {video} has enough texture to find its camera (at most "
                f"{max(counts)} features): record with more light, focus and overlap."
            )
    across = [p for p in pairs if video_of(p.first) != video_of(p.second)]
    if not across:
        return (
            "no frame of one shows anything that is also recognised in the other: "
            "record both captures of the same place, from similar viewpoints."
        )
    if all(pair.shift < STILL for pair in pairs):
        return "the camera does not move (no parallax): walk around the scene while recording."
    if not has_parallax(pairs):
        return (
            "the camera only turns on the spot, or sees a single flat surface (no parallax): "
            "move it sideways while recording."
        )
    alone = {v: any(q.registered[v] >= 0.5 * q.total[v] > 0.5 for q in qualities) for v in VIDEOS}
    if all(alone.values()):
        return (
            "each was reconstructed on its own, but too few points were recognised in both: "
            "record both from similar viewpoints and in similar light."
        )
    return (
        "too few matches agree with one arrangement of the cameras: "
        "record more frames with more overlap, and move the camera between them."
    )
