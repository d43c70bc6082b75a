"""``boxes.json``: what a network boxed in a run, before anything was made of it.

Kept beside ``changes.json`` so that boxes can be judged by themselves, with the partner that each
has in the other capture. Places are pixels of the input picture, as in ``changes.json``.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baselines.cyws.boxes import Corners
from scenediff_classic.cameras import source_from_view
from scenediff_classic.dataset import records
from scenediff_classic.errors import InputError
from scenediff_classic.types import VIDEOS, Rle, Video, View

NAME = "boxes.json"
_DIGITS = 6
Box = tuple[float, float, float, float]
"""x, y, width, height in pixels of the input picture."""


@dataclass(frozen=True)
class Spot:
    """A box in one sampled frame, and its mask out of the regions that it holds."""

    video: Video
    frame: int
    box: Box
    mask: Rle


@dataclass(frozen=True)
class RawBox:
    """A box as a network reported it."""

    here: Spot
    score: float
    partner: Spot | None
    """The same change as the other capture's view shows it; None if nothing was paired."""


def source_box(xyxy: Corners, view: View) -> Box:
    """Box around a box of the undistorted view, in its input picture and cut to it.

    A lens bends edges: their middles count beside their ends.
    """
    x0, y0, x1, y1 = xyxy
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    outline = np.array(
        [(x0, y0), (x, y0), (x1, y0), (x1, y), (x1, y1), (x, y1), (x0, y1), (x0, y)], float
    )
    there = source_from_view(outline, view.lens, view.intrinsics)
    limit = view.lens.width, view.lens.height
    low, high = (np.clip(end, 0, limit) for end in (there.min(axis=0), there.max(axis=0)))
    left, top, wide, high_ = (float(v) for v in (*low, *(high - low)))
    return left, top, wide, high_


def boxes_text(boxes: Sequence[RawBox]) -> str:
    """The file's text; the same boxes always give the same bytes."""
    items = [
        {
            **_spot_json(item.here),
            "score": _rounded(item.score),
            "partner": None if item.partner is None else _spot_json(item.partner),
        }
        for item in boxes
    ]
    return json.dumps({"schema": 1, "boxes": items}, indent=1, allow_nan=False) + "\n"


def _spot_json(spot: Spot) -> dict[str, Any]:
    return {
        "video": spot.video,
        "frame": spot.frame,
        "box": [_rounded(v) for v in spot.box],
        "rle": {"size": list(spot.mask.size), "counts": spot.mask.counts},
    }


def _rounded(value: float) -> float:
    return float(f"{float(value):.{_DIGITS}g}")


def read_boxes(path: Path) -> tuple[RawBox, ...]:
    """The boxes of a run, in the file's order.

    Raises
    ------
    InputError
        If the file is absent, damaged, or of another version.
    """
    content = records.mapping(records.read_json(path), str(path))
    if content.get("schema") != 1:
        raise InputError(f"{path}: 'schema' should be 1; the file is of another version.")
    items = records.sequence(records.entry(content, "boxes", str(path)), f"{path}: 'boxes'")
    return tuple(_raw_box(item, f"{path}: boxes[{k}]") for k, item in enumerate(items))


def _raw_box(value: object, where: str) -> RawBox:
    record = records.mapping(value, where)
    here = _spot(record, where)
    other = records.entry(record, "partner", where)
    partner = None if other is None else _spot(other, f"{where}.partner")
    if partner is not None and partner.video == here.video:
        raise InputError(f"{where} has a partner in its own capture.")
    score = records.number(records.entry(record, "score", where), f"{where}.score")
    return RawBox(here, score, partner)


def _spot(value: object, where: str) -> Spot:
    record = records.mapping(value, where)
    video = records.entry(record, "video", where)
    if video not in VIDEOS:
        raise InputError(f"{where}.video should be one of {', '.join(VIDEOS)}.")
    sides = records.sequence(records.entry(record, "box", where), f"{where}.box")
    if len(sides) != 4:
        raise InputError(f"{where}.box should have four numbers.")
    x, y, wide, high = (records.number(v, f"{where}.box") for v in sides)
    return Spot(
        video,
        records.index(records.entry(record, "frame", where), f"{where}.frame"),
        (x, y, wide, high),
        records.mask(records.entry(record, "rle", where), f"{where}.rle"),
    )
