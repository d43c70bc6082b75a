"""What photos and video frames have in common: limits, orientation, size."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8

from scenediff_classic.errors import InputError

MAX_PIXELS = 150_000_000
"""Largest input picture that is decoded (below Pillow's own limit of 179 million)."""

MIN_SIDE = 16
"""Smallest width and height that a picture may have, in pixels."""

BLANK_DEVIATION = 2.0
"""Standard deviation (grey levels) up to which a picture counts as blank: a lens cap's noise."""


@dataclass(frozen=True)
class Picture:
    """One decoded picture, upright and already reduced to its working size."""

    name: str
    image: UInt8[np.ndarray, "h w 3"]
    width: int
    """Upright width of the input picture, in pixels."""
    height: int
    time_s: float | None = None
    """Seconds since the first frame of a video; None for a photo."""
    focal_px: float | None = None
    """Focal length in pixels of the input picture, if its metadata tell."""


@dataclass(frozen=True)
class Turn:
    """What makes a stored picture upright: first transpose, then mirror."""

    transpose: bool = False
    mirror_x: bool = False
    mirror_y: bool = False

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Upright (width, height) of a stored picture of that size."""
        return (height, width) if self.transpose else (width, height)

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The upright picture, as a copy; `image` is (h, w) or (h, w, c)."""
        if self.transpose:
            image = image.swapaxes(0, 1)
        if self.mirror_x:
            image = image[:, ::-1]
        if self.mirror_y:
            image = image[::-1]
        return np.array(image, order="C")


def check_size(width: int, height: int, what: str) -> None:
    """Refuse pictures too large to decode safely, or too small to be of use.

    Raises
    ------
    InputError
        The message starts with `what`.
    """
    if width * height > MAX_PIXELS:
        raise InputError(
            f"{what} has {width} x {height} pixels, more than the limit of "
            f"{MAX_PIXELS // 1_000_000} million: make it smaller first."
        )
    if min(width, height) < MIN_SIDE:
        raise InputError(
            f"{what} has only {width} x {height} pixels: each side needs at least {MIN_SIDE}."
        )


def shrink(image: UInt8[np.ndarray, "h w c"], max_long_side: int) -> UInt8[np.ndarray, "h2 w2 c"]:
    """Average down so that the longer side has at most `max_long_side` pixels; never enlarge."""
    height, width = image.shape[:2]
    factor = max_long_side / max(height, width)
    if factor >= 1:
        return image
    size = max(round(width * factor), 1), max(round(height * factor), 1)
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def is_blank(image: UInt8[np.ndarray, "h w 3"]) -> bool:
    """Whether a picture shows nothing: one colour, give or take the noise of a covered lens."""
    _, deviation = cv2.meanStdDev(image)
    return float(deviation.max()) <= BLANK_DEVIATION
