"""Exposure and white balance, equalised over all views of both captures.

Colours can only be compared across captures when the cameras' gains are known. The static scene
gives them away: most surfaces seen from two views are the same surface, and differ in colour by
one factor per channel and view. A robust fit of these factors leaves changed objects, shadows
and highlights out.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, UInt8

from scenediff_classic.cameras import sample
from scenediff_classic.change.visibility import Comparable, VisibilityConfig, reproject
from scenediff_classic.types import Geometry, Video


@dataclass(frozen=True)
class HarmoniseConfig:
    """How the gains are fitted."""

    samples: int = 400
    """Pixels compared per view pair."""
    prior: float = 3.0
    """Weight of 'no gain', in samples: keeps views without partners as they are."""
    robust_scale: float = 0.1
    """Log-ratio residual beyond which a sample loses influence (Cauchy weights)."""
    iterations: int = 12


@dataclass(frozen=True)
class Harmonised:
    """Views in equal light."""

    geometry: Geometry
    light: float
    """How much the light differs between the captures in ways that no gain explains: the typical
    (median) log ratio of colours of one surface, beyond that between views of one capture. 0.1 =
    10 %; 0 = the same light, or nothing that would tell: no surface in common, single photos."""


def harmonised(
    geometry: Geometry,
    pairs: Sequence[tuple[int, int]],
    config: HarmoniseConfig,
    visibility: VisibilityConfig,
) -> Harmonised:
    """The same views with per-channel gains divided out; the median view keeps its look.

    Parameters
    ----------
    pairs : sequence of (int, int)
        Positions of co-visible views across the captures; neighbours within each capture are
        added here.
    """
    links = sorted({*pairs, *_neighbours(geometry)})
    views = [Comparable.of(view, visibility) for view in geometry.views]
    samples = [s for i, j in links if (s := _samples(views, i, j, config, visibility)) is not None]
    if not samples:
        return Harmonised(geometry, 0.0)
    gains = fit_gains(samples, len(geometry.views), config)
    equalised = tuple(
        replace(v, image=_divided(v.image, g)) for v, g in zip(geometry.views, gains, strict=True)
    )
    videos: list[Video] = [view.video for view in geometry.views]
    light = light_difference(samples, gains, videos)
    return Harmonised(replace(geometry, views=equalised), light)


@dataclass(frozen=True)
class ColourPairs:
    """Log colours of the same surface points in two views."""

    first: int
    second: int
    log_ratio: Float64[np.ndarray, "n 3"]
    """log(first) - log(second)."""


def fit_gains(
    samples: Sequence[ColourPairs], views: int, config: HarmoniseConfig
) -> Float64[np.ndarray, "v 3"]:
    """Log gain of every view and channel; iteratively reweighted least squares."""
    gains = np.zeros((views, 3))
    for channel in range(3):
        for _ in range(config.iterations):
            matrix = np.eye(views) * config.prior
            right = np.zeros(views)
            for s in samples:
                residual = (
                    s.log_ratio[:, channel] - gains[s.first, channel] + gains[s.second, channel]
                )
                weights = 1 / (1 + (residual / config.robust_scale) ** 2)
                total, moment = weights.sum(), weights @ s.log_ratio[:, channel]
                matrix[[s.first, s.second], [s.first, s.second]] += total
                matrix[[s.first, s.second], [s.second, s.first]] -= total
                right[s.first] += moment
                right[s.second] -= moment
            gains[:, channel] = np.linalg.solve(matrix, right)
    return gains - np.median(gains, axis=0)


def light_difference(
    samples: Sequence[ColourPairs], gains: Float64[np.ndarray, "v 3"], videos: Sequence[Video]
) -> float:
    """See `Harmonised.light`; `videos` names the capture of each view."""
    within, across = [], []
    for s in samples:
        left = np.abs(s.log_ratio - gains[s.first] + gains[s.second])
        (within if videos[s.first] == videos[s.second] else across).append(left)
    if not within or not across:
        return 0.0
    usual, typical = (float(np.median(np.concatenate(left))) for left in (within, across))
    return math.sqrt(max(typical**2 - usual**2, 0.0))


def _neighbours(geometry: Geometry) -> list[tuple[int, int]]:
    position = {v.key: k for k, v in enumerate(geometry.views)}
    out = []
    for video in ("before", "after"):
        own = sorted(geometry.of(video), key=lambda v: v.index)
        out += [(position[a.key], position[b.key]) for a, b in itertools.pairwise(own)]
    return out


def _samples(
    views: Sequence[Comparable],
    i: int,
    j: int,
    config: HarmoniseConfig,
    visibility: VisibilityConfig,
) -> ColourPairs | None:
    seen = reproject(views[i], views[j], visibility)
    same = seen.visible & (np.abs(np.nan_to_num(seen.gap, nan=np.inf)) < visibility.agreement)
    rows, columns = np.nonzero(same)
    if len(rows) < 20:
        return None
    chosen = np.linspace(0, len(rows) - 1, min(config.samples, len(rows))).astype(int)
    rows, columns = rows[chosen], columns[chosen]
    here = views[i].view.image[rows, columns].astype(np.float64)
    there = sample(views[j].view.image.astype(np.float32), seen.xy[rows, columns][None])[0]
    usable = np.all((here > 12) & (here < 243) & (there > 12) & (there < 243), axis=1)
    if usable.sum() < 10:
        return None
    return ColourPairs(i, j, np.log(here[usable]) - np.log(there[usable].astype(np.float64)))


def _divided(image: UInt8[np.ndarray, "h w 3"], log_gain: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    table = np.clip(np.rint(np.arange(256)[:, None] * np.exp(-log_gain)), 0, 255).astype(np.uint8)
    return np.stack([table[image[..., c], c] for c in range(3)], axis=-1)
