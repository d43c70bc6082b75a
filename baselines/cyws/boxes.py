"""Boxes: out of the head's maps, how much they overlap, which are the same one twice."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int64

from baselines.cyws.decoder import HeadMaps
from baselines.cyws.registration import Registration

Corners = tuple[float, float, float, float]
"""x0, y0, x1, y1 in pixels."""
TOP = 100
"""Boxes of a picture at most."""
PAIRED = 0.1
"""Score above which boxes are paired, as published."""


@dataclass(frozen=True)
class Boxes:
    """Scored boxes of one picture, best first."""

    xyxy: Float32[np.ndarray, "n 4"]
    """x0, y0, x1, y1 in pixels; a box of one pixel is one wide."""
    score: Float32[np.ndarray, "n"]

    def take(self, rows: np.ndarray) -> "Boxes":
        """Some of them."""
        return Boxes(self.xyxy[rows], self.score[rows])

    def scaled(self, x: float, y: float) -> "Boxes":
        """For the same picture at another size."""
        return Boxes(self.xyxy * np.array([x, y, x, y], np.float32), self.score)


@dataclass(frozen=True)
class BoxPair:
    """One change: its box in the first picture and in the second; one of them may be missing."""

    first: Corners | None
    second: Corners | None
    score: float


def decode(maps: HeadMaps, height: int, width: int, top: int = TOP) -> list[Boxes]:
    """Boxes of every picture of a batch: the strongest peaks of the heat map.

    Parameters
    ----------
    height, width : int
        Of the pictures, in pixels.
    """
    chance = maps.heat.detach().float().sigmoid()
    peak = torch.nn.functional.max_pool2d(chance, 3, 1, 1) == chance
    rows, columns = chance.shape[-2:]
    flat = torch.where(peak, chance, 0).flatten(1)
    score, cell = torch.sort(flat, dim=1, descending=True, stable=True)
    score, cell = score[:, :top], cell[:, :top]
    cell_x, cell_y = width / columns, height / rows

    def at(values: torch.Tensor) -> torch.Tensor:
        return values.detach().float().flatten(2).gather(2, cell[:, None].expand(-1, 2, -1))

    size, offset = at(maps.size).clamp(min=0), at(maps.offset)
    centre = torch.stack([cell % columns, cell // columns], 1) + offset
    corners = torch.cat([centre - size / 2, centre + size / 2], 1).transpose(1, 2)
    corners = corners * corners.new_tensor([cell_x, cell_y, cell_x, cell_y])
    limit = corners.new_tensor([width, height, width, height])
    xyxy = torch.minimum(corners.clamp(min=0), limit).cpu().numpy()
    found = score.cpu().numpy()
    return [Boxes(b[s > 0].astype(np.float32), s[s > 0]) for b, s in zip(xyxy, found, strict=True)]


def areas(boxes: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n"]:
    """In square pixels."""
    return (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])


def iou(a: Float[np.ndarray, "n 4"], b: Float[np.ndarray, "m 4"]) -> Float[np.ndarray, "n m"]:
    """Intersection over union of all with all."""
    low = np.maximum(a[:, None, :2], b[None, :, :2])
    high = np.minimum(a[:, None, 2:], b[None, :, 2:])
    common = np.prod(np.maximum(high - low, 0), axis=-1)
    union = areas(a)[:, None] + areas(b)[None] - common
    return common / np.maximum(union, 1e-9)


def suppress(boxes: Boxes, overlap: float = 0.2) -> Boxes:
    """Greedy non-maximum suppression: of boxes that overlap more, the best stays."""
    return boxes.take(survivors(boxes, overlap))


def survivors(boxes: Boxes, overlap: float = 0.2) -> Int64[np.ndarray, "k"]:
    """Rows that non-maximum suppression leaves, the best first (see `suppress`)."""
    keep: list[int] = []
    rest = np.argsort(-boxes.score, kind="stable")
    while len(rest):
        best, rest = int(rest[0]), rest[1:]
        keep.append(best)
        rest = rest[iou(boxes.xyxy[[best]], boxes.xyxy[rest])[0] <= overlap]
    return np.array(keep, np.int64)


def filtered(boxes: Boxes, height: int, width: int) -> Boxes:
    """As before pairing: no boxes below 400 of 224 x 224 square pixels, none that overlap."""
    large = areas(boxes.xyxy) >= 400 / 224**2 * height * width
    return suppress(boxes.take(np.flatnonzero(large)))


def grown(boxes: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
    """A pixel larger on every side, as the published evaluation of CYWS-2D has all boxes."""
    return boxes + np.array([-1, -1, 1, 1], boxes.dtype)


def pair_boxes(
    first: Boxes,
    second: Boxes,
    size_first: tuple[int, int],
    size_second: tuple[int, int],
    registration: Registration | None,
    pair: int = 0,
    least: float = PAIRED,
) -> list[BoxPair]:
    """Which boxes of the two pictures are one change.

    The centre of each box that scores above `least` is carried into the other picture; of the
    boxes that hold it there, the one with the nearest centre is its partner. Every box is in one
    pair at most, stronger pairs first; a pair's score is the better of its two.

    Parameters
    ----------
    size_first, size_second : (height, width)
        Of the pictures in which the boxes are given.
    registration : Registration, optional
        None: places correspond as they are.
    """
    boxes = first, second
    sizes = [np.array([w, h], float) for h, w in (size_first, size_second)]
    found: dict[tuple[int, int], float] = {}
    for side in (0, 1):
        own, other = boxes[side], boxes[1 - side]
        middle = (own.xyxy[:, :2] + own.xyxy[:, 2:]) / 2 / sizes[side]
        there = middle if registration is None else registration.carry(pair, side, middle)
        there = there * sizes[1 - side]
        for k in np.flatnonzero(own.score > least):
            holds = _holds(other, there[k])
            if not holds.any():
                continue
            centres = (other.xyxy[:, :2] + other.xyxy[:, 2:]) / 2
            away = np.where(holds, np.linalg.norm(centres - there[k], axis=1), np.inf)
            partner = int(away.argmin())
            key = (int(k), partner) if side == 0 else (partner, int(k))
            score = float(max(own.score[k], other.score[partner]))
            found[key] = max(found.get(key, 0.0), score)
    out, used = [], (set[int](), set[int]())
    for (a, b), score in sorted(found.items(), key=lambda item: (-item[1], item[0])):
        if a in used[0] or b in used[1]:
            continue
        used[0].add(a)
        used[1].add(b)
        out.append(BoxPair(corners_of(first, a), corners_of(second, b), score))
    for side in (0, 1):
        for k in np.flatnonzero(boxes[side].score > least):
            if int(k) not in used[side]:
                one = corners_of(boxes[side], int(k))
                ends = (one, None) if side == 0 else (None, one)
                out.append(BoxPair(*ends, float(boxes[side].score[k])))
    return sorted(out, key=lambda p: -p.score)


def _holds(boxes: Boxes, xy: np.ndarray) -> Bool[np.ndarray, "n"]:
    """Which boxes a place lies in (none, if it is unknown)."""
    b = boxes.xyxy
    return (b[:, 0] <= xy[0]) & (xy[0] <= b[:, 2]) & (b[:, 1] <= xy[1]) & (xy[1] <= b[:, 3])


def corners_of(boxes: Boxes, k: int) -> Corners:
    """One of the boxes."""
    x0, y0, x1, y1 = (float(v) for v in boxes.xyxy[k])
    return x0, y0, x1, y1
