"""Pictures inside the page itself: JPEG data URLs with their size and description."""

import base64
import io
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import UInt8
from PIL import Image

QUALITY = 80


@dataclass(frozen=True)
class Picture:
    """An embedded picture."""

    url: str
    width: int
    height: int
    alt: str


def jpeg(image: UInt8[np.ndarray, "h w 3"], quality: int = QUALITY) -> bytes:
    """The picture as a JPEG file."""
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "JPEG", quality=quality, optimize=True)
    return stream.getvalue()


def embed(image: UInt8[np.ndarray, "h w 3"], alt: str) -> Picture:
    """The picture as a data URL."""
    url = "data:image/jpeg;base64," + base64.b64encode(jpeg(image)).decode("ascii")
    return Picture(url, image.shape[1], image.shape[0], alt)


def fit(image: UInt8[np.ndarray, "h w 3"], long_side: int) -> UInt8[np.ndarray, "h2 w2 3"]:
    """The picture, reduced so that its long side is at most `long_side`."""
    height, width = image.shape[:2]
    shrink = long_side / max(height, width)
    if shrink >= 1:
        return image
    size = (max(round(width * shrink), 1), max(round(height * shrink), 1))
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)
