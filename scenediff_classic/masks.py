"""Run-length masks: coding, measuring, combining, resizing.

`Rle` is COCO's compressed form: column-major runs of background and foreground, in turn, each
written in base 32 relative to the run two before. Values that come from a file go through
`verified` first: pycocotools trusts its input, and reads past the end of a damaged one.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Int64
from pycocotools import mask as coco

from scenediff_classic.errors import InputError
from scenediff_classic.types import Rle

MAX_SIDE = 16_384
"""Longest side, in pixels, of a mask that a file may hold."""
MAX_AREA = 2**27
"""Most pixels of a mask that a file may hold: a guard against sizes that exhaust memory."""


def encode(mask: Bool[np.ndarray, "h w"]) -> Rle:
    """Run-length form of a mask."""
    height, width = mask.shape
    record: Any = coco.encode(np.asfortranarray(mask, dtype=np.uint8))
    return Rle((height, width), record["counts"].decode("ascii"))


def decode(rle: Rle) -> Bool[np.ndarray, "h w"]:
    """Pixels of a run-length mask."""
    runs = run_lengths(rle)
    columns_first = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
    return np.ascontiguousarray(columns_first.reshape(rle.size, order="F"))


def area(rle: Rle) -> int:
    """Number of pixels in the mask."""
    return int(coco.area(_record(rle)))


def bbox(rle: Rle) -> tuple[float, float, float, float]:
    """Tightest box, (x, y, width, height) in pixels; all zero for an empty mask."""
    x, y, width, height = (float(v) for v in coco.toBbox(_record(rle)))
    return x, y, width, height


def merge(rles: Sequence[Rle]) -> Rle:
    """Pixels in any of the masks; they must be of one size, and at least one."""
    return _combine(rles, intersect=False)


def intersection(first: Rle, second: Rle) -> int:
    """Number of pixels in both masks."""
    return area(_combine((first, second), intersect=True))


def union(first: Rle, second: Rle) -> int:
    """Number of pixels in either mask."""
    return area(first) + area(second) - intersection(first, second)


def iou(first: Rle, second: Rle) -> float:
    """Intersection over union; 0 if both masks are empty."""
    shared = intersection(first, second)
    total = area(first) + area(second) - shared
    return shared / total if total else 0.0


def nearest_indices(size_in: int, size_out: int) -> Int64[np.ndarray, "size_out"]:
    """Source position of every target position in a nearest-neighbour resize along one axis.

    Single precision on purpose: the published evaluator resizes so, and exact arithmetic picks
    the neighbouring source pixel for some sizes.
    """
    step = np.float32(size_in) / np.float32(size_out)
    source = np.floor(np.arange(size_out, dtype=np.float32) * step).astype(np.int64)
    return np.minimum(source, size_in - 1)


def resize(rle: Rle, height: int, width: int) -> Rle:
    """Nearest-neighbour resize; thin masks can vanish."""
    if rle.size == (height, width):
        return rle
    rows = nearest_indices(rle.size[0], height)
    columns = nearest_indices(rle.size[1], width)
    return encode(decode(rle)[np.ix_(rows, columns)])


def run_lengths(rle: Rle) -> Int64[np.ndarray, "runs"]:
    """Lengths of the alternating runs, the first one background, column by column.

    Raises
    ------
    ValueError
        The text is not COCO's coding.
    """
    codes = np.frombuffer(rle.counts.encode("latin-1", "replace"), np.uint8).astype(np.int64) - 48
    if codes.size == 0 or codes.min() < 0 or codes.max() > 63 or codes[-1] & 32:
        raise ValueError("not a COCO run-length string")
    starts = np.r_[0, np.flatnonzero((codes & 32) == 0)[:-1] + 1]
    digit = np.arange(codes.size) - np.repeat(starts, np.diff(np.r_[starts, codes.size]))
    if digit.max() > 6:  # seven digits hold every 32-bit length, sign included
        raise ValueError("a run length is out of range")
    values = np.add.reduceat((codes & 31) << (5 * digit), starts)
    last = np.r_[starts[1:], codes.size] - 1
    negative = (codes[last] & 16) != 0
    values -= np.where(negative, np.int64(1) << (5 * (digit[last] + 1)), 0)
    values[1::2] = np.cumsum(values[1::2])
    values[2::2] = np.cumsum(values[2::2])
    return values


def verified(size: object, counts: object, where: str) -> Rle:
    """A mask read from a file, or a clear refusal.

    Parameters
    ----------
    size : object
        (height, width) as found in the file.
    counts : object
        COCO's compressed runs as found in the file, text or bytes.
    where : str
        File and place, for the message.

    Raises
    ------
    InputError
        The mask is malformed, larger than `MAX_SIDE` or `MAX_AREA`, or its runs do not fill
        its size exactly.
    """
    height, width = _verified_size(size, where)
    if isinstance(counts, bytes):
        counts = counts.decode("latin-1")
    if not isinstance(counts, str):
        raise InputError(f"{where}: the mask's 'counts' must be COCO's compressed run-length text.")
    rle = Rle((height, width), counts)
    try:
        runs = run_lengths(rle)
    except ValueError as error:
        raise InputError(f"{where}: the mask cannot be decoded ({error}).") from error
    if runs.min() < 0 or runs.max() > height * width or runs.sum() != height * width:
        raise InputError(f"{where}: the mask's runs do not fill its {height} x {width} pixels.")
    return rle


def _verified_size(size: object, where: str) -> tuple[int, int]:
    sides = tuple(size) if isinstance(size, list | tuple) else ()
    if len(sides) != 2 or any(isinstance(s, bool) or not isinstance(s, int) for s in sides):
        raise InputError(f"{where}: the mask's 'size' must be [height, width].")
    height, width = sides
    if min(sides) < 1 or max(sides) > MAX_SIDE or height * width > MAX_AREA:
        raise InputError(f"{where}: a mask of {height} x {width} pixels is not plausible.")
    return height, width


def _combine(rles: Sequence[Rle], intersect: bool) -> Rle:
    size = rles[0].size
    if any(rle.size != size for rle in rles):
        raise ValueError(f"masks differ in size: {sorted({rle.size for rle in rles})}")
    merged: Any = coco.merge([_record(rle) for rle in rles], intersect)
    return Rle(size, merged["counts"].decode("ascii"))


def _record(rle: Rle) -> Any:
    return {"size": list(rle.size), "counts": rle.counts}
