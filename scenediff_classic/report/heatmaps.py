"""Score maps beside their view: what each term says, and what was thresholded."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from scenediff_classic.report.embedded import Picture, embed, fit
from scenediff_classic.report.palette import heat
from scenediff_classic.types import Evidence, ScoreMaps, View

TERMS = ("geometry", "feature", "region", "total")

_LONG_SIDE = 300
_LEAST_TOP = 0.05
"""Smallest upper end of a colour bar, so that a pair without change is not blown up to noise."""
_CONTOUR = (90, 230, 255)


@dataclass(frozen=True)
class Scale:
    """The colour bar of one term, shared by all views."""

    term: str
    top: float
    """Score painted in the brightest colour."""
    threshold: float | None
    """Where the threshold lies on the bar, 0 to 1; only for the total."""


@dataclass(frozen=True)
class ScoreRow:
    """One view and its maps, in the order of `TERMS`."""

    title: str
    image: Picture
    maps: tuple[Picture, ...]


def scales(scores: tuple[ScoreMaps, ...], threshold: float | None) -> tuple[Scale, ...]:
    """One colour bar per term: its 99.5 percentile over all views, and past the threshold."""
    bars = []
    for term in TERMS:
        values = [np.ravel(getattr(maps, term)) for maps in scores]
        pooled = np.concatenate([np.zeros(1, np.float32), *values])
        top = max(float(np.nanpercentile(pooled, 99.5)), _LEAST_TOP)
        mark = None
        if term == "total" and threshold is not None:
            top = max(top, 1.25 * threshold)
            mark = threshold / top
        bars.append(Scale(term, top, mark))
    return tuple(bars)


def score_rows(
    evidence: Evidence, positions: tuple[int, ...], bars: tuple[Scale, ...], threshold: float | None
) -> tuple[ScoreRow, ...]:
    """The given views (positions in the geometry) with their maps."""
    return tuple(
        score_row(evidence.geometry.views[i], evidence.scores[i], bars, threshold)
        for i in positions
    )


def score_row(
    view: View, maps: ScoreMaps, bars: tuple[Scale, ...], threshold: float | None
) -> ScoreRow:
    """One view with its maps."""
    title = f"{view.video} · frame {view.index}"
    panels = []
    for bar in bars:
        values: Float32[np.ndarray, "h w"] = getattr(maps, bar.term)
        panel = fit(heat(values, bar.top), _LONG_SIDE)
        if bar.term == "total" and threshold is not None:
            panel = _contoured(panel, np.nan_to_num(values) > threshold)
        finite = values[np.isfinite(values)]
        most = f"highest {finite.max():.3f}" if finite.size else "no view pair could tell"
        panels.append(embed(panel, f"{bar.term} score of {title}: {most}"))
    return ScoreRow(title, embed(fit(view.image, _LONG_SIDE), title), tuple(panels))


def _contoured(panel: UInt8[np.ndarray, "h w 3"], above: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    height, width = panel.shape[:2]
    mask = cv2.resize(above.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    contours, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    canvas = panel.copy()
    cv2.drawContours(canvas, contours, -1, _CONTOUR, 1, cv2.LINE_AA)
    return canvas
