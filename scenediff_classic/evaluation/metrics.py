"""The numbers of a pair, or of many pairs together."""

from dataclasses import dataclass


@dataclass(frozen=True)
class PixelCounts:
    """Changed pixels, summed over frames."""

    hit: int = 0
    false: int = 0
    missed: int = 0

    def __add__(self, other: "PixelCounts") -> "PixelCounts":
        return PixelCounts(
            self.hit + other.hit, self.false + other.false, self.missed + other.missed
        )

    @property
    def total(self) -> int:
        """Pixels in the union of prediction and truth."""
        return self.hit + self.false + self.missed


@dataclass(frozen=True)
class Metrics:
    """The benchmark's metrics, each from 0 to 1; None = nothing to find and nothing reported."""

    px_im_iou: float | None
    """IoU of changed pixels (paper, Sec. 3: px/im IoU)."""
    obj_im_ap: float | None
    """AP of objects in single views (obj/im AP)."""
    obj_sc_ap: float | None
    """AP of objects over the whole scene, whatever their change type (obj/sc AP)."""
    obj_sc_ap_typed: float | None
    """obj/sc AP that also asks for the right change type."""
    true_objects: int
    reported_objects: int
    found_objects: int
    """True objects found, whatever their change type."""
    pixels: PixelCounts
