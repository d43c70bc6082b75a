"""KC-3D's rendered pairs: pictures, masks of what changed, depth and cameras in our conventions.

The layout is as its authors published it, as far as it is known: one pair was at hand, without
masks and with its cameras in plain arrays, so the list of pairs and the pose files are read by
description. Their pickles are read without running anything (`dataset.pickles`).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8
from PIL import Image

from scenediff_classic.cameras import pixel_centres
from scenediff_classic.dataset.pickles import read_npy, read_pickle
from scenediff_classic.errors import InputError

CAMERA_FROM_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
DepthKind = Literal["ray", "z"]
"""What depth files hold: distances to the camera's centre, or along its axis."""


@dataclass(frozen=True)
class RenderedPhoto:
    """One picture of a pair."""

    name: str
    image: UInt8[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"]
    """z-depth; NaN = nothing there."""
    intrinsics: Float64[np.ndarray, "3 3"]
    """In pixels of the picture."""
    cam_from_world: Float64[np.ndarray, "4 4"]
    changed: Bool[np.ndarray, "h w"]
    """True where it differs from the other picture of the pair."""


@dataclass(frozen=True)
class Kc3d:
    """The set: which pairs each split has. Reading changes nothing of it."""

    root: Path
    splits: dict[str, tuple[dict[str, str], ...]]

    def pairs(
        self, split: str, depth_kind: DepthKind = "ray"
    ) -> Iterator[tuple[RenderedPhoto, RenderedPhoto]]:
        """The pairs of a split, in the order of the set.

        Parameters
        ----------
        depth_kind : {"ray", "z"}
            What the depth files hold. On the pair at hand the two pictures agree only as "ray".

        Raises
        ------
        InputError
            If there is no such split, or a file is missing or damaged.
        """
        if split not in self.splits:
            raise InputError(f"{self.root} has no split '{split}', but {', '.join(self.splits)}.")
        for record in self.splits[split]:
            first, second = (self._photo(record, k, depth_kind) for k in (1, 2))
            yield first, second

    def _photo(self, record: dict[str, str], number: int, depth_kind: DepthKind) -> RenderedPhoto:
        path = inside(self.root, record[f"image{number}"])
        image = _read(path)
        if image.ndim != 3 or image.shape[2] < 3:
            raise InputError(f"{path} is no colour picture.")
        height, width = image.shape[:2]
        raw = _read(inside(self.root, record[f"depth{number}"]))
        mask = _read(inside(self.root, record[f"mask{number}"]))
        if raw.shape != (height, width) or mask.shape[:2] != (height, width):
            raise InputError(f"Depth and mask of {path} are not of its size {width}x{height}.")
        lens, pose = _camera(path, number, height, width)
        depth = np.where(raw > 0, raw, np.nan).astype(np.float32)
        return RenderedPhoto(
            name=path.stem,
            image=np.ascontiguousarray(image[..., :3]),
            depth=z_from_ray(depth, lens) if depth_kind == "ray" else depth,
            intrinsics=lens,
            cam_from_world=pose,
            changed=np.any(mask.reshape(height, width, -1) > 0, axis=2),
        )


def read_kc3d(root: Path) -> Kc3d:
    """The list of pairs, from ``data_split.pkl``: for each split image1, image2, mask1, mask2,
    depth1 and depth2 of every pair, as paths below the folder.

    Raises
    ------
    InputError
        If the file is missing, damaged, or of another layout.
    """
    path = root / "data_split.pkl"
    content = read_pickle(path)
    names = [f"{what}{k}" for what in ("image", "mask", "depth") for k in (1, 2)]
    splits: dict[str, tuple[dict[str, str], ...]] = {}
    try:
        for split, records in content.items():
            splits[str(split)] = tuple(
                {name: _text(record[name]) for name in names} for record in records
            )
    except (AttributeError, KeyError, TypeError) as error:
        raise InputError(
            f"{path} is not KC-3D's list of pairs: it should have lists of records with "
            f"{', '.join(names)}."
        ) from error
    return Kc3d(root, splits)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(value)
    return value


def inside(root: Path, name: str) -> Path:
    """A file below a folder, named by a file that is not trusted."""
    path = root / name
    if not path.resolve().is_relative_to(root.resolve()):
        raise InputError(f"{root}: the file '{name}' lies outside this folder and is not read.")
    return path


def _camera(
    image: Path, number: int, height: int, width: int
) -> tuple[Float64[np.ndarray, "3 3"], Float64[np.ndarray, "4 4"]]:
    """From the pose file named by the first three fields of the picture's name."""
    fields = image.stem.split("_")
    path = image.with_name("_".join(fields[:3]) + ".npy")
    content = read_npy(path)
    index = int(fields[3]) if len(fields) > 3 and fields[3].isdigit() else number - 1
    try:
        lens = np.asarray(content["intrinsics"], float)
        position = np.asarray(content["positions"], float)[index]
        rotation = np.asarray(content["rotations"], float)[index]
        lens = lens[index] if lens.ndim == 3 else lens
        if lens.shape != (3, 3) or rotation.shape != (3, 3) or position.shape != (3,):
            raise ValueError(lens.shape)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(
            f"{path} holds no camera {index}: it should have intrinsics (3 x 3, or one for each "
            "picture), positions and rotations."
        ) from error
    return kc3d_camera(lens, rotation, position, height, width)


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


def _read(path: Path) -> np.ndarray:
    try:
        with Image.open(path) as picture:
            return np.asarray(picture)
    except OSError as error:
        raise InputError(f"{path} cannot be read as a picture: {error}.") from error
