"""Which scores mean change: maximum-entropy threshold with a no-change outcome (paper Sec. 4.3)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from scenediff_classic.types import ScoreMaps

NOISE_FLOOR = 0.11
"""What unchanged regions of pictures of some 500 pixels stay below."""


@dataclass(frozen=True)
class ThresholdConfig:
    """How the change threshold is chosen; set `fixed` for a value of your own."""

    percentile: float = 70.0
    """Only visible pixels above this percentile enter the histogram."""
    bins: int = 256
    noise_floor: float | None = None
    """No score below this is ever a change: maximum entropy splits pure noise as well. None =
    `NOISE_FLOOR`, or what the preset says."""
    certain: float = 0.22
    """A score above this is a change whatever the histogram says: where all the background is
    quiet, maximum entropy cuts between strong changes and stronger ones."""
    fixed: float | None = None

    @property
    def floor(self) -> float:
        """The noise floor as a number."""
        return NOISE_FLOOR if self.noise_floor is None else self.noise_floor


def change_threshold(maps: Sequence[ScoreMaps], config: ThresholdConfig) -> float:
    """One threshold for both captures; regions with a strictly greater score changed."""
    if config.fixed is not None:
        return config.fixed
    pixels = np.concatenate([m.total[np.isfinite(m.total)][::4] for m in maps])
    if len(pixels) == 0:
        return config.floor
    upper = pixels[pixels > np.percentile(pixels, config.percentile)]
    if len(upper) == 0:  # a constant map has nothing above any percentile
        return config.floor
    entropy = maximum_entropy_threshold(upper, config.bins)
    return min(max(entropy, config.floor), config.certain)


def maximum_entropy_threshold(values: Float[np.ndarray, "n"], bins: int = 256) -> float:
    """Kapur, Sahoo & Wong 1985: the cut that maximises the summed entropy of both sides.

    The cut lies at bin edge ``min + t (max - min) / bins`` for the first maximum over t.
    """
    low, high = float(np.min(values)), float(np.max(values))
    if high <= low:
        return high
    counts, _ = np.histogram(values, bins=bins, range=(low, high))
    p = counts / counts.sum()
    below = np.cumsum(p)
    information = np.cumsum(np.where(p > 0, -p * np.log(np.where(p > 0, p, 1)), 0))
    above = 1 - below
    ok = (below > 1e-12) & (above > 1e-12)
    safe_below, safe_above = np.where(ok, below, 1), np.where(ok, above, 1)
    entropy = (
        np.log(safe_below)
        + information / safe_below
        + np.log(safe_above)
        + (information[-1] - information) / safe_above
    )
    t = int(np.argmax(np.where(ok, entropy, -np.inf)))
    return low + t * (high - low) / bins
