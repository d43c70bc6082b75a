"""Changes as users read them: kind, confidence, place, size, and a mask in every view."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scenediff_classic.cameras import mask_to_source
from scenediff_classic.change.changed_regions import ChangedRegion, pair_scores
from scenediff_classic.change.moves import Change
from scenediff_classic.change.objects import SceneObject
from scenediff_classic.masks import bbox, encode
from scenediff_classic.types import (
    ChangedObject,
    Geometry,
    Kind,
    ObjectView,
    PairScore,
    Support,
    TermScores,
)

STRONGEST = 5
"""Comparisons that are named; the others are only counted."""

FULL = 10
"""Frames of a capture from which on more of them make no difference by themselves."""


@dataclass(frozen=True)
class ConfidenceConfig:
    """How sure a change is: the chance that it is one, by logistic regression.

    The constants come from ``python -m data_tools.benchmarks.calibration`` on the objects found in
    the rendered val pairs (10 frames a capture, estimated geometry).
    """

    base: float = 1.37
    per_score: float = 3.66
    """Log odds for each unit of the change score."""
    per_doubling: float = 2.09
    """Log odds each time that twice as many frames show the object; see `looks`."""

    def __call__(self, score: float, frames: float, placed: int) -> float:
        """Between 0 and 1; grows with the score and with the number of frames that show it.

        Parameters
        ----------
        frames : float
            Frames of the capture that show the object.
        placed : int
            All frames of the capture that have a camera.
        """
        odds = self.base + self.per_score * score
        odds += self.per_doubling * math.log2(looks(frames, placed))
        return 1 / (1 + math.exp(-odds))


def looks(frames: float, placed: int) -> float:
    """How much has been seen of an object; 1 = ten frames of ten.

    In a smaller capture, fewer frames prove as much as their share of the capture and as their
    number would, in the geometric mean: that is an assumption, for the constants come from captures
    of ten. In a larger one nothing is lost by frames that look elsewhere.
    """
    return max(frames, 1) / math.sqrt(FULL * min(max(placed, 1), FULL))


def describe(
    changes: Sequence[Change], geometry: Geometry, threshold: float, confidence: ConfidenceConfig
) -> tuple[ChangedObject, ...]:
    """Objects for the result, most confident first, ids from 1."""
    items = [_object(c, geometry, threshold, confidence) for c in changes]
    items = [i for i in items if i.views]
    items.sort(key=lambda i: (-i.confidence, i.kind, i.centroid_after or i.centroid_before or ()))
    return tuple(_with_id(item, k + 1) for k, item in enumerate(items))


def _object(
    change: Change, geometry: Geometry, threshold: float, confidence: ConfidenceConfig
) -> ChangedObject:
    sides = [s for s in (change.before, change.after) if s is not None]
    kind: Kind = "moved" if len(sides) == 2 else "removed" if change.before else "added"
    views = tuple(v for s in sides for v in _views(s, geometry, confidence))
    regions = [r for s in sides for r in s.regions]
    centroid_before, extent_before = _place(change.before, geometry.unit)
    centroid_after, extent_after = _place(change.after, geometry.unit)
    return ChangedObject(
        id=0,
        kind=kind,
        confidence=float(np.mean([v.confidence for v in views])) if views else 0.0,
        centroid_before=centroid_before,
        centroid_after=centroid_after,
        extent_before=extent_before,
        extent_after=extent_after,
        scores=TermScores(
            *(
                float(np.mean([getattr(r.terms, t) for r in regions]))
                for t in ("geometry", "feature", "region")
            )
        ),
        views=views,
        support=_support(regions, geometry, threshold),
        match=change.match,
    )


def _support(regions: Sequence[ChangedRegion], geometry: Geometry, threshold: float) -> Support:
    """What single pairs of views say."""
    scores = pair_scores(regions)
    strongest = sorted(scores, key=lambda pair: (-scores[pair], pair))[:STRONGEST]
    return Support(
        compared=len(scores),
        above=sum(score > threshold for score in scores.values()),
        strongest=tuple(
            PairScore(*geometry.views[a].key, geometry.views[b].index, scores[a, b])
            for a, b in strongest
        ),
    )


def _views(item: SceneObject, geometry: Geometry, confidence: ConfidenceConfig) -> list[ObjectView]:
    by_view: dict[int, list[ChangedRegion]] = {}
    for region in item.regions:
        by_view.setdefault(region.view, []).append(region)
    frames, placed = len(by_view), len(geometry.of(item.video))
    out = []
    for k in sorted(by_view, key=lambda k: geometry.views[k].index):
        view, regions = geometry.views[k], by_view[k]
        mask = np.logical_or.reduce([r.mask for r in regions])
        source = mask_to_source(mask, view.lens, view.intrinsics)
        if not source.any():
            continue
        rle = encode(source)
        score = float(
            np.average([r.score for r in regions], weights=[r.mask.sum() for r in regions])
        )
        out.append(
            ObjectView(view.video, view.index, confidence(score, frames, placed), bbox(rle), rle)
        )
    return out


def _place(
    item: SceneObject | None, unit: float
) -> tuple[tuple[float, float, float] | None, tuple[float, float, float] | None]:
    if item is None or len(item.points) == 0:
        return None, None
    points = item.points * unit
    low, high = np.percentile(points, [5, 95], axis=0)
    extent = high - low
    x, y, z = np.median(points, axis=0)
    return (float(x), float(y), float(z)), (float(extent[0]), float(extent[1]), float(extent[2]))


def _with_id(item: ChangedObject, number: int) -> ChangedObject:
    return replace(item, id=number)
