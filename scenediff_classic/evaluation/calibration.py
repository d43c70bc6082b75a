"""Whether confidence means what it says: among findings of 0.7, seven of ten should be right."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float64


@dataclass(frozen=True)
class Reliability:
    """Findings by confidence, in bins of equal width."""

    edges: Float64[np.ndarray, "n+1"]
    share: Float64[np.ndarray, "n"]
    """Of all findings; sums to 1 unless there are none."""
    confidence: Float64[np.ndarray, "n"]
    """Mean in the bin; NaN where it is empty."""
    right: Float64[np.ndarray, "n"]
    """How many of the bin's findings are right; NaN where it is empty."""

    @property
    def error(self) -> float:
        """Expected calibration error (Naeini et al. 2015): mean gap, weighted by share."""
        return float(np.nansum(self.share * np.abs(self.confidence - self.right)))

    def rows(self) -> list[str]:
        """A diagram in text: confidence, share of the findings, how many are right."""
        found = []
        for k in np.flatnonzero(self.share > 0):
            low, high, right = self.edges[k], self.edges[k + 1], self.right[k]
            bar = "#" * round(40 * right)
            found.append(f"{low:.1f}-{high:.1f} {self.share[k]:6.1%}  {right:6.1%}  {bar}")
        return found


def reliability(
    confidence: Float[np.ndarray, "n"], right: Bool[np.ndarray, "n"], bins: int = 10
) -> Reliability:
    """Compare confidence (0 to 1) with how often it was right."""
    number = np.minimum((confidence * bins).astype(int), bins - 1)
    count = np.bincount(number, minlength=bins)

    def mean(values: np.ndarray) -> np.ndarray:
        sums = np.bincount(number, values, minlength=bins)
        return np.divide(sums, count, out=np.full(bins, np.nan), where=count > 0)

    return Reliability(
        edges=np.linspace(0, 1, bins + 1),
        share=count / max(len(confidence), 1),
        confidence=mean(confidence),
        right=mean(right.astype(float)),
    )
