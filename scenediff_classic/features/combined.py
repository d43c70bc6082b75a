"""Several kinds of features as one."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from scenediff_classic.protocols import FeatureExtractor
from scenediff_classic.types import View


@dataclass(frozen=True)
class CombinedFeatures:
    """Unit vectors side by side, weighted so that cosines average.

    The cosine similarity of the whole is the weighted mean of the parts' similarities.
    """

    parts: tuple[FeatureExtractor, ...]
    """All on the same grid."""
    weights: tuple[float, ...]
    """Share of each part in the similarity; they sum to 1."""
    similarity: float
    merge: float

    def __post_init__(self) -> None:
        """Refuse weights that would not give unit length."""
        if len(self.parts) != len(self.weights) or not np.isclose(sum(self.weights), 1):
            raise ValueError("Each part needs one weight, and weights must sum to 1.")

    def __call__(self, view: View) -> Float32[np.ndarray, "h w c"]:
        """Unit-length features on the grid of the parts."""
        weighted = [
            part(view) * np.float32(weight**0.5)
            for part, weight in zip(self.parts, self.weights, strict=True)
        ]
        return np.concatenate(weighted, axis=-1)
