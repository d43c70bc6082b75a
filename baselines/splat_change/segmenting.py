"""The thing in a box: what a box-prompted segmenter answers, and a classical one."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8

from scenediff_classic.colour import lab_colours
from scenediff_classic.masks import encode, iou

Box = tuple[int, int, int, int]
"""x0, y0, x1, y1 in pixels; the last column and row are not part of it."""


@dataclass(frozen=True)
class Segment:
    """The thing in a box."""

    mask: Bool[np.ndarray, "h w"]
    score: float
    """Trust in the mask, 0 to 1."""


@runtime_checkable
class BoxSegmenter(Protocol):
    """Finds the one thing that a box is about; holds the threshold that belongs to its score."""

    @property
    def least(self) -> float:
        """Score from which on there is a thing in the box."""
        ...

    def __call__(self, image: UInt8[np.ndarray, "h w 3"], box: Box) -> Segment:
        """An empty mask with score 0 where nothing stands out."""
        ...


@dataclass(frozen=True)
class GrabCutBoxes:
    """GrabCut (Rother et al. 2004), started from the box several times, a little shifted.

    A thing has an outline of its own: whatever the box exactly is, the same mask comes out, and
    colours differ across its border. The score is the mean overlap of the mask with those from
    shifted boxes, times how much of the border is an edge of the picture.
    """

    least: float = 0.5
    """See docs/baselines.md for how it was chosen."""
    iterations: int = 4
    margin: float = 0.15
    """The box grows by this share of its size at each side: GrabCut needs to see what is around."""
    around: float = 0.5
    """What lies farther from it than this share of the box's size is not looked at."""
    shifts: tuple[tuple[float, float, float, float], ...] = (
        (0.07, 0.07, 0.07, 0.07), (-0.07, -0.07, -0.07, -0.07),
        (0.06, -0.06, 0.06, -0.06), (-0.06, 0.06, -0.06, 0.06),
    )  # fmt: skip
    """Of x0, y0, x1, y1, as shares of the box's size."""
    contrast: float = 0.12
    """Colour difference across the border (in Lab, lightness from 0 to 1) that is surely an edge;
    0 = the border does not count."""

    def __call__(self, image: UInt8[np.ndarray, "h w 3"], box: Box) -> Segment:
        """The thing in the box."""
        height, width = image.shape[:2]
        x0, y0, x1, y1 = box
        sides = np.array([x1 - x0, y1 - y0, x1 - x0, y1 - y0], float)
        grown = np.array(box, float) + self.margin * sides * [-1, -1, 1, 1]
        reach = (self.margin + self.around) * sides
        window = _clipped(np.array(box) + reach * [-1, -1, 1, 1], height, width)
        cut = image[window[1] : window[3], window[0] : window[2]]
        origin = np.array([*window[:2], *window[:2]])
        first = self._once(cut, grown - origin)
        empty = Segment(np.zeros((height, width), bool), 0.0)
        if not first.any():
            return empty
        others = [self._once(cut, grown - origin + np.array(s) * sides) for s in self.shifts]
        stable = np.mean([iou(encode(first), encode(other)) for other in others])
        score = float(stable) * self._edge_share(cut, first)
        whole = np.zeros((height, width), bool)
        whole[window[1] : window[3], window[0] : window[2]] = first
        return Segment(whole, score)

    def _once(self, image: np.ndarray, box: np.ndarray) -> Bool[np.ndarray, "h w"]:
        height, width = image.shape[:2]
        x0, y0, x1, y1 = _clipped(box, height, width)
        labels = np.full((height, width), cv2.GC_BGD, np.uint8)
        labels[y0:y1, x0:x1] = cv2.GC_PR_FGD
        inside = (x1 - x0) * (y1 - y0)
        # GrabCut fits five colours to each side and cannot do so with fewer pixels
        if inside < 30 or height * width - inside < 30:
            return np.zeros((height, width), bool)
        cv2.setRNGSeed(0)
        models = np.zeros((1, 65)), np.zeros((1, 65))
        cv2.grabCut(
            np.ascontiguousarray(image), labels, (0, 0, 1, 1), *models, self.iterations,
            cv2.GC_INIT_WITH_MASK,
        )  # fmt: skip
        return (labels == cv2.GC_PR_FGD) | (labels == cv2.GC_FGD)

    def _edge_share(self, image: np.ndarray, mask: Bool[np.ndarray, "h w"]) -> float:
        """How far colours differ across the mask's border, mean over the border, at most 1."""
        if self.contrast <= 0:
            return 1.0
        lab = lab_colours(image)
        kernel = np.ones((3, 3), np.uint8)
        thin = cv2.erode(mask.astype(np.uint8), kernel, iterations=1, borderValue=1) > 0
        wide = cv2.dilate(mask.astype(np.uint8), kernel, iterations=2) > 0
        border = mask & ~thin
        outside = wide & ~mask
        if not border.any() or not outside.any():
            return 0.0
        mean_outside = _mean_near(lab, outside)
        mean_inside = _mean_near(lab, mask)
        step = np.linalg.norm(mean_inside - mean_outside, axis=-1)[border]
        return float(np.nanmean(np.minimum(step / self.contrast, 1)))


def parts(
    segment: Segment, least: int, changed: Bool[np.ndarray, "h w"], inside: float
) -> list[Segment]:
    """Connected parts of a mask that are large enough and lie where something changed.

    Parameters
    ----------
    least : int
        Pixels of a part.
    inside : float
        Share of a part that must lie in `changed`.
    """
    count, labels = cv2.connectedComponents(segment.mask.astype(np.uint8))
    out = []
    for k in range(1, count):
        mask = labels == k
        area = int(mask.sum())
        if area >= least and (mask & changed).sum() >= inside * area:
            out.append(Segment(mask, segment.score))
    return out


def _mean_near(
    planes: Float32[np.ndarray, "h w c"], where: Bool[np.ndarray, "h w"]
) -> Float32[np.ndarray, "h w c"]:
    """Mean over the selected pixels of a 7 x 7 window; NaN without any."""
    weight = cv2.blur(where.astype(np.float32), (7, 7))
    sums = cv2.blur(planes.astype(np.float32) * where[..., None].astype(np.float32), (7, 7))
    return sums / np.where(weight > 1e-6, weight, np.nan)[..., None]


def _clipped(box: np.ndarray, height: int, width: int) -> Box:
    x0, y0 = (max(int(np.floor(v)), 0) for v in box[:2])
    x1, y1 = int(np.ceil(box[2])), int(np.ceil(box[3]))
    return x0, y0, min(max(x1, x0), width), min(max(y1, y0), height)
