"""How firmly each frame is placed: what holds its camera, and a confidence made of that."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float64

from scenediff_classic.geometry.registration.quality import MAX_ERROR, bridging
from scenediff_classic.geometry.registration.sparse_model import SparseModel, residuals
from scenediff_classic.types import Placement, View

HALF_POINTS = 50
"""So many points are worth half of what any number is worth to a picture's confidence."""
HALF_SHARED = 12
"""The same for points that the other capture observes as well."""
CELLS = 4
"""Cells along each side of a picture in which its points are sought."""
FULL_COVER = 0.5
"""Share of the cells that is as good as all of them."""
LOW_CONFIDENCE = 0.25
"""Frames placed with less are named in a warning: two of the shares at half, say."""
MOST_NAMED = 12
"""Most frames that a warning names."""


def placements(
    model: SparseModel, shares: Mapping[str, float] | None = None
) -> tuple[Placement, ...]:
    """How firmly each picture is placed, in the order of `SparseModel.pictures`.

    The confidence is a product of five shares, each of which grows with one figure alone::

        points / (points + HALF_POINTS)
        shared / (shared + HALF_SHARED)
        min(1, cover / FULL_COVER)
        1 / (1 + (error / MAX_ERROR)^2)
        agreement, where it is known

    The first four say how much holds the camera, in its own capture and to the other one: repeated
    things can hold it firmly in a wrong place. The last one asks the matches that mapping dropped.
    Cameras that are wrong in the same way agree with each other, and are not told by it.

    Parameters
    ----------
    shares : mapping, optional
        The agreement by picture name, where it is known: see `agreement`.
    """
    shares = shares or {}
    both = bridging(model)
    errors = np.linalg.norm(residuals(model), axis=1)
    point, picture = model.points.observations.T
    return tuple(
        _placement(
            model,
            number,
            both[point[picture == number]],
            errors[picture == number],
            shares.get(posed.name),
        )
        for number, posed in enumerate(model.pictures)
    )


def _placement(
    model: SparseModel,
    number: int,
    both: Bool[np.ndarray, "k"],
    errors: Float64[np.ndarray, "k"],
    agreement: float | None,
) -> Placement:
    """Of one picture, from its observations: whether the other capture sees them, and errors."""
    lens = model.pictures[number].lens
    assert model.keypoints is not None
    found = model.keypoints[model.points.observations[:, 1] == number]
    cells = np.clip(found / [lens.width, lens.height] * CELLS, 0, CELLS - 1).astype(int)
    cover = len(np.unique(cells, axis=0)) / CELLS**2
    ahead = errors[np.isfinite(errors)]
    error = float(ahead.mean()) if len(ahead) else float("inf")
    points, shared = len(both), int(both.sum())
    confidence = (
        points / (points + HALF_POINTS)
        * shared / (shared + HALF_SHARED)
        * min(1.0, cover / FULL_COVER)
        / (1 + (error / MAX_ERROR) ** 2)
        * (1.0 if agreement is None else agreement)
    )  # fmt: skip
    return Placement(confidence, points, shared, cover, error, agreement)


def low_confidence_warning(views: Sequence[View]) -> tuple[str, ...]:
    """A sentence that names the frames of little confidence; nothing if there are none."""
    low = [(v, v.placement.confidence) for v in views if v.placement]
    low = [(v, confidence) for v, confidence in low if confidence < LOW_CONFIDENCE]
    if not low:
        return ()
    names = [f"{v.video} {v.index} ({confidence:.2f})" for v, confidence in low]
    listed = ", ".join(names[:MOST_NAMED]) + (" and more" if len(names) > MOST_NAMED else "")
    noun = "frame was" if len(low) == 1 else "frames were"
    return (
        f"{len(low)} {noun} placed with low confidence, and what is reported there may be "
        f"misplaced: {listed}.",
    )
