"""The colours of the report: one place, so that pictures, page and 3D view agree."""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from scenediff_classic.types import Kind, Video

Colour = tuple[int, int, int]
"""Red, green, blue, 0 to 255."""

KIND_COLOUR: dict[Kind, Colour] = {
    "added": (51, 204, 102),
    "removed": (255, 51, 51),
    "moved": (0, 153, 255),
}
VIDEO_COLOUR: dict[Video, Colour] = {"before": (46, 111, 214), "after": (214, 58, 58)}
"""Cameras in the 3D view: before blue, after red, as in the paper's figures."""

INK: Colour = (16, 16, 20)
"""Text on a kind's colour: near black reaches a contrast of 5:1 or more on all three."""


def css(colour: Colour) -> str:
    """The colour as a CSS hex string."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def heat(values: Float32[np.ndarray, "h w"], top: float) -> UInt8[np.ndarray, "h w 3"]:
    """Paint values from 0 (black) to `top` (pale yellow); unknown (NaN) is hatched grey."""
    level = np.clip(np.nan_to_num(values) / top, 0, 1) * 255
    bgr = cv2.applyColorMap(np.rint(level).astype(np.uint8), cv2.COLORMAP_INFERNO)
    rgb = np.ascontiguousarray(bgr[..., ::-1])
    row, column = np.indices(values.shape)
    hatch = np.where((row + column) // 3 % 3 == 0, 150, 120).astype(np.uint8)
    unknown = np.isnan(values)
    rgb[unknown] = hatch[unknown][:, None]
    return rgb


def heat_gradient(stops: int = 9) -> str:
    """The scale of `heat` as a CSS gradient, low values to the left."""
    ramp = np.linspace(0, 1, stops, dtype=np.float32)[None]
    colours = heat(ramp, 1.0)[0]
    listed = ", ".join(css((int(r), int(g), int(b))) for r, g, b in colours)
    return f"linear-gradient(to right, {listed})"
