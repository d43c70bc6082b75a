"""RC-3D's pairs of photos with depth and boxes.

The layout is as its authors published it. One pair was at hand: the whole set has not been read
yet.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image

from scenediff_classic.errors import InputError


@dataclass(frozen=True)
class BoxedPhoto:
    """One photo of a pair."""

    name: str
    image: UInt8[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "a b"]
    """z-depth in metres, smaller than the photo; NaN = unknown."""
    boxes: Float32[np.ndarray, "n 4"]
    """Of what differs: x0, y0, x1, y1 in pixels of the photo."""


def read_rc3d(root: Path) -> Iterator[tuple[BoxedPhoto, BoxedPhoto]]:
    """The pairs of RC-3D: the first and the third photo of each triple.

    Parameters
    ----------
    root : Path
        Folder with ``part1/coco_annotations.json`` and so on; beside a photo ``<stem>.jpg`` lies
        ``depth_<stem>.png`` (16 bits, millimetres, 0 = unknown).

    Raises
    ------
    InputError
        If there are no annotations, or a file cannot be read.
    """
    files = sorted(root.glob("part*/coco_annotations.json"))
    if not files:
        raise InputError(f"{root} holds no part1/coco_annotations.json and so on.")
    for file in files:
        photos = annotated_photos(file)
        for k in range(0, len(photos) - 2, 3):
            first, third = (_photo(file.parent, *photos[i]) for i in (k, k + 2))
            yield first, third


def read_rc3d_depth(path: Path) -> Float32[np.ndarray, "a b"]:
    """Metres from a 16-bit picture in millimetres; NaN where it is 0."""
    raw = _read(path).astype(np.float32)
    return np.where(raw > 0, raw / np.float32(1000), np.float32(np.nan))


def annotated_photos(file: Path) -> list[tuple[str, Float32[np.ndarray, "n 4"]]]:
    """(file name, boxes) of every photo, in the order of the file.

    Raises
    ------
    InputError
        The file is absent or not in COCO's layout.
    """
    try:
        content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        boxes: dict[int, list[list[float]]] = {int(i["id"]): [] for i in content["images"]}
        for note in content["annotations"]:
            x, y, wide, high = (float(v) for v in note["bbox"])
            boxes[int(note["image_id"])].append([x, y, x + wide, y + high])
        return [
            (str(i["file_name"]), np.array(boxes[int(i["id"])], np.float32).reshape(-1, 4))
            for i in content["images"]
        ]
    except (OSError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise InputError(f"{file} is not in COCO's layout: {error!r}.") from error


def _photo(folder: Path, name: str, boxes: np.ndarray) -> BoxedPhoto:
    path = folder / name
    depth = read_rc3d_depth(path.with_name(f"depth_{path.stem}.png"))
    image = _read(path)
    if image.ndim != 3:
        raise InputError(f"{path} is no colour photo.")
    return BoxedPhoto(path.stem, np.ascontiguousarray(image[..., :3]), depth, boxes)


def _read(path: Path) -> np.ndarray:
    try:
        with Image.open(path) as picture:
            return np.asarray(picture)
    except OSError as error:
        raise InputError(f"{path} cannot be read as a picture: {error}.") from error
