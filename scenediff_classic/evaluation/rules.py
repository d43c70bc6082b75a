"""What an evaluation mode decides."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from scenediff_classic.dataset import AnnotatedPair, Prediction
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.matching import match_best, match_free
from scenediff_classic.evaluation.official import official_grid, same_motion
from scenediff_classic.evaluation.strict import same_kind, strict_grid
from scenediff_classic.types import Kind, Video

Mode = Literal["strict", "official"]
Grid = Callable[[Video, int], tuple[int, int]]
"""(height, width) at which the masks of a capture's sampled frame are compared."""
Matcher = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Rules:
    """The choices in which the two modes differ."""

    mode: Mode
    grid: Callable[[AnnotatedPair, Prediction], Grid]
    match_regions: Matcher
    """For obj/im AP."""
    match_objects: Matcher
    """For obj/sc AP."""
    same_type: Callable[[Kind, Kind], bool]
    """Whether a predicted and a true change type agree."""
    counts_missing: bool
    """Whether a pair without a usable prediction counts, as all missed."""
    undefined: float | None
    """Value of a metric with nothing to find and nothing reported."""


def rules_of(mode: Mode, region_duplicates: int = 1, object_duplicates: int = 1) -> Rules:
    """The rules of a mode.

    Parameters
    ----------
    mode : {"strict", "official"}
    region_duplicates, object_duplicates : int
        The published evaluator's tolerance for repeated detections in obj/im AP and in
        obj/sc AP (see `match_best`); strict mode has none.

    Raises
    ------
    InputError
        The mode is unknown, or strict mode was asked to tolerate duplicates.
    """
    if min(region_duplicates, object_duplicates) < 1:
        raise InputError("The tolerance for duplicates must be at least 1, which allows none.")
    if mode == "official":
        return Rules(
            mode="official",
            grid=official_grid,
            match_regions=partial(match_best, duplicates=region_duplicates),
            match_objects=partial(match_best, duplicates=object_duplicates),
            same_type=same_motion,
            counts_missing=False,
            undefined=0.0,
        )
    if mode != "strict":
        raise InputError(f"'{mode}' is no evaluation mode: choose strict or official.")
    if max(region_duplicates, object_duplicates) > 1:
        raise InputError("Strict mode counts every duplicate: choose official mode to allow some.")
    return Rules(
        mode="strict",
        grid=strict_grid,
        match_regions=match_free,
        match_objects=match_free,
        same_type=same_kind,
        counts_missing=True,
        undefined=None,
    )
