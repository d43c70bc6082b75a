"""Perceptual colours on a scale of their own."""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8


def lab_colours(image: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "h w 3"]:
    """CIE Lab of an sRGB picture, all three channels divided by 100."""
    return cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_RGB2Lab) / 100
