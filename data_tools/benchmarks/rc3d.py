"""RC-3D's pairs of photos with depth and boxes, and KC-3D's conventions of depth and cameras.

Layouts as their authors published them. One pair of either was at hand: whole sets have not been
read yet.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, UInt8
from PIL import Image

from scenediff_classic.cameras import pixel_centres
from scenediff_classic.errors import InputError

CAMERA_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


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


def z_from_ray(
    length: Float32[np.ndarray, "h w"], intrinsics: Float64[np.ndarray, "3 3"]
) -> Float32[np.ndarray, "h w"]:
    """z-depth from distances to the camera, which KC-3D's depth files seem to hold."""
    xy = pixel_centres(*length.shape)
    x = (xy[..., 0] - intrinsics[0, 2]) / intrinsics[0, 0]
    y = (xy[..., 1] - intrinsics[1, 2]) / intrinsics[1, 1]
    return (length / np.sqrt(1 + x * x + y * y)).astype(np.float32)


def kc3d_camera(
    intrinsics: np.ndarray, rotation: np.ndarray, position: np.ndarray, height: int, width: int
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "4 4"]]:
    """A camera of KC-3D in our conventions.

    Parameters
    ----------
    intrinsics, rotation, position : array (3, 3), (3, 3), (3,)
        As stored: for pictures of side 1 and a camera that looks along -z with y up; rotation and
        position take camera to world.
    height, width : int
        Of the picture.

    Returns
    -------
    intrinsics : array (3, 3)
        In pixels.
    cam_from_world : array (4, 4)
    """
    lens = np.diag([width, height, 1.0]) @ np.asarray(intrinsics, float)
    world_from_cam = np.eye(4)
    world_from_cam[:3, :3], world_from_cam[:3, 3] = rotation, position
    return lens @ CAMERA_FROM_OPENGL[:3, :3], CAMERA_FROM_OPENGL @ np.linalg.inv(world_from_cam)


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
