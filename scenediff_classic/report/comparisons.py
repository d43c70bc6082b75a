"""Captured pictures beside what a model of the other capture shows from the same cameras."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8

from scenediff_classic.report.drawing import outline
from scenediff_classic.report.embedded import Picture, embed, fit
from scenediff_classic.report.palette import heat
from scenediff_classic.types import Comparison, Evidence

PANELS = ("captured", "rendered", "difference", "found")

_LONG_SIDE = 320
_LEAST_TOP = 0.05
"""As for score maps: where nothing differs, noise is not blown up."""
_FOUND = (255, 51, 51)


@dataclass(frozen=True)
class ComparisonRow:
    """One view: its panels, in the order of `PANELS`."""

    title: str
    panels: tuple[Picture, ...]


def difference_top(comparisons: Sequence[Comparison]) -> float:
    """The difference that is painted brightest: the 99.5 percentile over all views."""
    values = [np.ravel(c.difference) for c in comparisons]
    pooled = np.concatenate([np.zeros(1, np.float32), *values])
    return max(float(np.nanpercentile(pooled, 99.5)), _LEAST_TOP)


def panels(one: Comparison, top: float) -> tuple[UInt8[np.ndarray, "h w 3"], ...]:
    """The pictures of a comparison, all of its size, in the order of `PANELS`."""
    found = one.captured.copy()
    outline(found, one.found, _FOUND, 1)
    return one.captured, one.rendered, heat(one.difference, top), found


def comparison_rows(evidence: Evidence, positions: Sequence[int]) -> tuple[ComparisonRow, ...]:
    """Those of the given views (positions in the geometry) that were compared with a model."""
    top = difference_top(evidence.comparisons)
    by_view = {one.view: one for one in evidence.comparisons}
    rows = []
    for k in positions:
        if k in by_view:
            view = evidence.geometry.views[k]
            title = f"{view.video} · frame {view.index}"
            pictures = (fit(panel, _LONG_SIDE) for panel in panels(by_view[k], top))
            named = zip(pictures, PANELS, strict=True)
            rows.append(ComparisonRow(title, tuple(embed(p, f"{title}, {n}") for p, n in named)))
    return tuple(rows)
