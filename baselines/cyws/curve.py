"""The learning curve as a picture."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw


@dataclass(frozen=True)
class CurvePoint:
    """How a training stands at one validation."""

    pairs: int
    """Shown so far."""
    loss: float
    """Mean since the last validation."""
    ap50: float
    """Of the validation pairs, 0 to 1."""
    seconds: float
    """Processor time of the training so far."""


def draw_curve(
    curve: Sequence[CurvePoint], title: str, width: int = 640, height: int = 400
) -> UInt8[np.ndarray, "h w 3"]:
    """AP50 (blue, 0 to 1) and loss (grey, relative to its first value) over pairs shown."""
    canvas = Image.new("RGB", (width, height), "white")
    pen = ImageDraw.Draw(canvas)
    left, right, top, bottom = 50, width - 20, 40, height - 40
    most = max((p.pairs for p in curve), default=1)

    def at(pairs: float, value: float) -> tuple[float, float]:
        clipped = min(max(value, 0.0), 1.0)
        return left + pairs / most * (right - left), bottom - clipped * (bottom - top)

    for tick in range(0, 11, 2):
        x, y = at(0, tick / 10)
        pen.line([(x, y), (right, y)], fill="#dddddd")
        pen.text((x - 30, y - 6), f"{tick / 10:.1f}", fill="black")
        x, y = at(most * tick / 10, 0)
        pen.text((x - 14, y + 8), f"{most * tick / 10:.0f}", fill="black")
    if curve:
        first = curve[0].loss
        pen.line([at(p.pairs, p.loss / first) for p in curve], fill="#999999", width=2)
        pen.line([at(p.pairs, p.ap50) for p in curve], fill="#1f5fbf", width=3)
    pen.text((left, 8), title, fill="black")
    pen.text((left, 22), "blue: AP50 of validation pairs    grey: loss", fill="#555555")
    pen.text((right - 90, bottom + 24), "pairs shown", fill="black")
    return np.asarray(canvas)
