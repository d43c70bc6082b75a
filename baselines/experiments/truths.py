"""What truly changed in a pair, and which of a method's objects are which of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64

from scenediff_classic.dataset import SAMPLE_STEP, AnnotatedPair, read_annotations
from scenediff_classic.errors import InputError
from scenediff_classic.masks import bbox
from scenediff_classic.report.drawing import mask_at
from scenediff_classic.types import VIDEOS, ChangeResult, Kind, ObjectView, Video

MATCHED = 0.5
"""IoU over all frames above which an answer is the true object, as in the paper."""
_SIDE = 320
"""Masks are compared at this longer side: enough to tell which object is which."""

Spot = tuple[Video, int]
"""A capture and the index of one of its sampled frames."""


@dataclass(frozen=True)
class Thing:
    """A changed object, true or reported, with its masks."""

    id: int
    kind: Kind
    label: str
    views: Mapping[Spot, ObjectView]


def true_things(truth: Path | None) -> tuple[Thing, ...] | None:
    """The changed objects that were annotated; None where the truth is no masks of objects."""
    if truth is None:
        return None
    try:
        return things_of(read_annotations(truth))
    except InputError:
        return None


def things_of(pair: AnnotatedPair) -> tuple[Thing, ...]:
    """The flagged objects with their masks in sampled frames."""
    out = []
    for item in pair.objects:
        views: dict[Spot, ObjectView] = {}
        for video in VIDEOS:
            track = pair.track(video, item.object_id) if item.present(video) else None
            for seen in track.masks if track else ():
                frame, rest = divmod(seen.frame, SAMPLE_STEP)
                if rest == 0:
                    box = bbox(seen.mask)
                    views[video, frame] = ObjectView(video, frame, 1.0, box, seen.mask)
        if item.kind is not None:
            out.append(Thing(item.object_id, item.kind, item.label, views))
    return tuple(out)


def reported_things(result: ChangeResult) -> tuple[Thing, ...]:
    """The objects of an answer, most confident first."""
    ranked = sorted(result.objects, key=lambda item: (-item.confidence, item.id))
    return tuple(
        Thing(i.id, i.kind, f"{i.id}", {(v.video, v.frame): v for v in i.views}) for i in ranked
    )


Grid = Mapping[tuple[int, Spot], Bool[np.ndarray, "h w"]]
"""Position of a thing and a frame -> its mask on a small grid."""


def gridded(things: Sequence[Thing]) -> Grid:
    """All masks at a small size."""
    return {
        (position, spot): mask_at(view, *_small(view.mask.size))
        for position, thing in enumerate(things)
        for spot, view in thing.views.items()
    }


def _small(size: tuple[int, int]) -> tuple[int, int]:
    shrink = min(_SIDE / max(size), 1.0)
    return max(round(size[0] * shrink), 1), max(round(size[1] * shrink), 1)


def overlaps(
    reported: Grid, true: Grid, counts: tuple[int, int]
) -> Float64[np.ndarray, "reported true"]:
    """IoU of every reported object with every true one, over all frames of both captures.

    Parameters
    ----------
    counts : (int, int)
        How many objects each of the two has.
    """
    shared = np.zeros(counts)
    mine, theirs = np.zeros(counts[0]), np.zeros(counts[1])
    for (i, _), mask in reported.items():
        mine[i] += mask.sum()
    for (j, spot), mask in true.items():
        theirs[j] += mask.sum()
        for i in range(counts[0]):
            other = reported.get((i, spot))
            if other is not None and other.shape == mask.shape:
                shared[i, j] += np.logical_and(other, mask).sum()
    return shared / np.maximum(mine[:, None] + theirs[None] - shared, 1)


def matches(iou: Float64[np.ndarray, "reported true"]) -> dict[int, int]:
    """Reported -> true, most confident first, each true object once."""
    found: dict[int, int] = {}
    for i, row in enumerate(iou):
        free = [j for j in range(len(row)) if row[j] > MATCHED and j not in found.values()]
        if free:
            found[i] = max(free, key=lambda j: row[j])
    return found
