"""What a matcher finds for one view, before other views have confirmed it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32

from scenediff_classic.geometry.stereo.depth_confidence import ConfidenceWeights
from scenediff_classic.types import View


@dataclass(frozen=True)
class DepthMap:
    """Depth of one view, not yet confirmed."""

    depth: Float32[np.ndarray, "h w"]
    """z-depth, NaN = none."""
    cost: Float32[np.ndarray, "h w"]
    """0 (looks identical in the sources) to 1 (nothing like it found)."""
    planes: Float32[np.ndarray, "h w 3"]
    """Inverse depth and its change per column and per row, at each pixel."""

    @staticmethod
    def nothing(shape: tuple[int, int]) -> "DepthMap":
        """No depth anywhere."""
        empty = np.full(shape, np.nan, np.float32)
        return DepthMap(empty, np.ones_like(empty), np.zeros((*shape, 3), np.float32))


@runtime_checkable
class Matcher(Protocol):
    """Finds the depth of a view in its sources. A frozen dataclass whose fields are options."""

    confidence_weights: ClassVar[ConfidenceWeights]
    """What its costs say about how likely its depth is right."""

    def search(self, view: View, others: Sequence[View], points: np.ndarray) -> DepthMap:
        """Depth from pictures alone; `points` (n, 3) are world points that the view observes."""
        ...

    def revise(
        self,
        view: View,
        others: Sequence[View],
        points: np.ndarray,
        found: DepthMap,
        settled: Bool[np.ndarray, "h w"],
    ) -> DepthMap:
        """Depth from pictures and from the depth that `others` found; `settled` pixels stay."""
        ...
