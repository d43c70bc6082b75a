"""Does each picture stand where its own matches say? A check that mapping does not make.

Mapping drops the matches that contradict the cameras it has settled on, so that what is left can
hold a picture firmly in a wrong place. The matches of a pair were verified without any model; how
many of them fit a model is told by its cameras alone. Only pairs within a capture are asked:
between the captures things move, and what moved fits cameras of its own.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from scenediff_classic.cameras import view_from_source
from scenediff_classic.geometry.registration.quality import video_of
from scenediff_classic.geometry.registration.sparse_model import (
    FeatureMatches,
    PosedPicture,
    SparseModel,
)

MISS = 0.006
"""Distance from the cameras' epipolar geometry, as a share of the longer side, at which a match
fits."""
LOOKED_AT = 300
"""At most so many matches of a pair are looked at."""
MIN_MATCHES = 30
"""A picture with fewer says nothing: pairs of 15 matches are verified by chance, and in right
models some fit not at all (PASLCD cantina: 0 of 15, 0 of 17)."""


@dataclass(frozen=True)
class Agreement:
    """How much of what a picture's matches say its camera fits."""

    share: float
    """Share of the matches that fit."""
    matches: int
    """Matches with pictures of the same capture."""


@dataclass(frozen=True)
class OwnMatches:
    """The verified matches by which the models of one recipe are checked."""

    pairs: tuple[FeatureMatches, ...]
    """Of pictures of one capture each; without those that guided matching added, which fit the
    pair's own geometry by construction, be it right or wrong."""
    found: Mapping[str, Float64[np.ndarray, "f 2"]]
    """Where the features of each picture are, in pixels."""

    def shares(self, model: SparseModel) -> dict[str, float]:
        """Share of its matches that each picture's camera fits; only where they are enough."""
        checks = agreements(model, self.pairs, self.found)
        return {name: a.share for name, a in checks.items() if a.matches >= MIN_MATCHES}


def agreements(
    model: SparseModel,
    pairs: Sequence[FeatureMatches],
    found: Mapping[str, Float64[np.ndarray, "f 2"]],
) -> dict[str, Agreement]:
    """Of each picture of a model, by name.

    Parameters
    ----------
    pairs : sequence of FeatureMatches
        Verified matches. Pairs across the captures, and pictures that the model lacks, are passed
        over.
    found : mapping
        Where the features of each picture are, in pixels.
    """
    posed = {picture.name: picture for picture in model.pictures}
    rays = {p.name: view_from_source(found[p.name], p.lens, np.eye(3)) for p in model.pictures}
    fitting, counted = dict.fromkeys(posed, 0.0), dict.fromkeys(posed, 0)
    for pair in pairs:
        names = (pair.first, pair.second)
        count = len(pair.features)
        here = pair.first in posed and pair.second in posed
        if not here or count == 0 or video_of(pair.first) != video_of(pair.second):
            continue
        some = pair.features[np.linspace(0, count - 1, min(count, LOOKED_AT)).astype(int)]
        seen = (rays[name][feature] for name, feature in zip(names, some.T, strict=True))
        fits = misses(posed[pair.first], posed[pair.second], *seen) < MISS  # NaN does not fit
        for name in names:
            fitting[name] += float(fits.mean()) * count
            counted[name] += count
    return {name: Agreement(fitting[name] / max(n, 1), n) for name, n in counted.items()}


def misses(
    first: PosedPicture,
    second: PosedPicture,
    rays_first: Float64[np.ndarray, "n 2"],
    rays_second: Float64[np.ndarray, "n 2"],
) -> Float64[np.ndarray, "n"]:
    """Sampson's distance of matches from two cameras' geometry, as a share of the longer side.

    Parameters
    ----------
    rays_first, rays_second : array (n, 2)
        Matched positions on the plane at depth 1, free of distortion.
    """
    relative = second.cam_from_world @ np.linalg.inv(first.cam_from_world)
    x, y, z = relative[:3, 3]
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ relative[:3, :3]
    one = np.column_stack([rays_first, np.ones(len(rays_first))])
    two = np.column_stack([rays_second, np.ones(len(rays_second))])
    line_one, line_two = two @ essential, one @ essential.T
    # on the plane at depth 1 the longer side of a picture is this long
    side_one, side_two = (
        max(p.lens.width, p.lens.height) / p.lens.intrinsics[0, 0] for p in (first, second)
    )
    slope = (line_one[:, :2] ** 2).sum(axis=1) * side_one**2
    slope += (line_two[:, :2] ** 2).sum(axis=1) * side_two**2
    return np.abs((two * line_two).sum(axis=1)) / np.sqrt(np.maximum(slope, 1e-300))
