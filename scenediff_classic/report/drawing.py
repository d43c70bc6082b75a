"""Changed objects painted into pictures: translucent masks, outlines, labels."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from PIL import Image, ImageDraw, ImageFont

from scenediff_classic.masks import decode
from scenediff_classic.report.palette import INK, KIND_COLOUR, Colour
from scenediff_classic.types import ChangedObject, ChangeResult, Kind, ObjectView, Video

_FILL = 0.3
"""Opacity of a mask: the object must stay recognisable underneath."""

_Box = tuple[int, int, int, int]
"""Left, top, right, bottom in pixels; right and bottom are outside."""


@dataclass(frozen=True)
class Mark:
    """An object to be painted into one picture."""

    id: int
    kind: Kind
    mask: Bool[np.ndarray, "h w"]
    """At the size of the picture."""
    tint: Colour | None = None
    """Where colours stand for something else than the kind."""
    text: str | None = None
    """Where it is called something else than its number and kind."""

    @property
    def label(self) -> str:
        """What the picture says of the object."""
        return self.text or f"{self.id} {self.kind}"

    @property
    def colour(self) -> Colour:
        """What it is painted in."""
        return self.tint or KIND_COLOUR[self.kind]


def mask_at(view: ObjectView, height: int, width: int) -> Bool[np.ndarray, "h w"]:
    """The mask of a view, brought from the input's size to the size of a picture."""
    mask = decode(view.mask)
    if mask.shape == (height, width):
        return mask.astype(bool)
    soft = cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    # "At least half" would erase what is thinner than a pixel of a reduced picture.
    return soft >= min(0.5, float(soft.max(initial=0.0)) or 0.5)


def marks_of(
    result: ChangeResult, video: Video, frame: int, height: int, width: int
) -> tuple[Mark, ...]:
    """The objects seen in one frame, at the size of its picture."""
    return tuple(
        Mark(item.id, item.kind, mask_at(view, height, width))
        for item in result.objects
        for view in views_in(item, video)
        if view.frame == frame
    )


def views_in(item: ChangedObject, video: Video) -> tuple[ObjectView, ...]:
    """The views of an object in one capture."""
    return tuple(view for view in item.views if view.video == video)


def draw_marks(
    image: UInt8[np.ndarray, "h w 3"],
    marks: tuple[Mark, ...],
    *,
    labels: bool = True,
    letters: float | None = None,
) -> UInt8[np.ndarray, "h w 3"]:
    """Paint objects over a copy of the picture, large ones first.

    Parameters
    ----------
    letters : float, optional
        Height of the labels' letters in pixels; after the picture's size if left out.
    """
    ordered = sorted(marks, key=lambda mark: (-int(mark.mask.sum()), mark.id))
    canvas = image.astype(np.float32)
    for mark in ordered:
        colour = np.array(mark.colour, np.float32)
        canvas[mark.mask] = (1 - _FILL) * canvas[mark.mask] + _FILL * colour
    canvas = np.rint(canvas).astype(np.uint8)
    line = max(round(max(image.shape[:2]) / 420), 1)
    for mark in ordered:
        outline(canvas, mark.mask, mark.colour, line)
    return _label(canvas, ordered, letters) if labels else canvas


def outline(
    canvas: UInt8[np.ndarray, "h w 3"], mask: Bool[np.ndarray, "h w"], colour: Colour, line: int
) -> None:
    """Draw a mask's outline in place: a dark rim keeps it visible on any background."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(canvas, contours, -1, INK, line + 2, cv2.LINE_AA)
    cv2.drawContours(canvas, contours, -1, colour, line, cv2.LINE_AA)


def stamp(image: UInt8[np.ndarray, "h w 3"], text: str) -> UInt8[np.ndarray, "h w 3"]:
    """Write a remark into the lower left corner of a copy of the picture."""
    picture = Image.fromarray(image)
    draw, font, pad = ImageDraw.Draw(picture), _font(image), _padding(image)
    width, height = _chip_size(text, font, pad)
    top = image.shape[0] - height
    draw.rectangle((0, top, width, image.shape[0]), fill=INK)
    draw.text((pad, top + height / 2), text, (245, 245, 245), font, anchor="lm")
    return np.asarray(picture)


def _label(
    canvas: UInt8[np.ndarray, "h w 3"], marks: list[Mark], letters: float | None
) -> UInt8[np.ndarray, "h w 3"]:
    picture = Image.fromarray(canvas)
    font = _font(canvas) if letters is None else ImageFont.load_default(letters)
    draw, pad = ImageDraw.Draw(picture), _padding(canvas)
    taken: list[_Box] = []
    for mark in marks:
        if not mark.mask.any():
            continue
        text = mark.label.replace(" ", "  ")  # the font's own space is too thin to be seen
        size = _chip_size(text, font, pad)
        box = _place(_bounds(mark.mask), size, canvas.shape[1], canvas.shape[0], taken)
        taken.append(box)
        left, top, right, bottom = box
        draw.rounded_rectangle((left, top, right - 1, bottom - 1), pad / 2, mark.colour, INK)
        draw.text((left + pad, (top + bottom) / 2), text, INK, font, anchor="lm")
    return np.asarray(picture)


def _font(image: np.ndarray) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(max(max(image.shape[:2]) / 38, 11))


def _padding(image: np.ndarray) -> int:
    return max(round(max(image.shape[:2]) / 150), 3)


def _chip_size(
    text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, pad: int
) -> tuple[int, int]:
    _, top, _, bottom = font.getbbox("Ag" + text)
    width = font.getlength(text)
    return int(width) + 2 * pad, int(bottom - min(top, 0)) + pad


def _bounds(mask: Bool[np.ndarray, "h w"]) -> _Box:
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return x, y, x + width, y + height


def _place(target: _Box, size: tuple[int, int], width: int, height: int, taken: list[_Box]) -> _Box:
    """Where a label goes: above its object if free, else below, inside, or beside it."""
    left, top, right, bottom = target
    wide, high = size
    corners = [(left, top - high), (left, bottom), (left, top), (right, top), (left - wide, top)]
    boxes = [_inside(x, y, wide, high, width, height) for x, y in corners]
    outside_first = sorted(boxes, key=lambda box: _overlap(box, target) > 0)
    free = [box for box in outside_first if not any(_overlap(box, other) for other in taken)]
    return (free or boxes)[0]


def _inside(x: int, y: int, wide: int, high: int, width: int, height: int) -> _Box:
    left = max(min(x, width - wide), 0)
    top = max(min(y, height - high), 0)
    return left, top, left + wide, top + high


def _overlap(a: _Box, b: _Box) -> int:
    return max(min(a[2], b[2]) - max(a[0], b[0]), 0) * max(min(a[3], b[3]) - max(a[1], b[1]), 0)
