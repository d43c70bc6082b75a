"""Captures: one video, one folder of photos, or one photo, as a `Capture` value."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool

from scenediff_classic.clips import VIDEO_SUFFIXES, Sampling, read_clip
from scenediff_classic.errors import InputError
from scenediff_classic.photos import (
    PHOTO_SUFFIXES,
    is_photo,
    list_photos,
    read_mask,
    read_photos,
    refuse_camera_format,
    sorted_folder,
)
from scenediff_classic.pictures import MIN_SIDE, Picture, is_blank
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.types import Capture, Frame, Video

MAX_CAPTURE_BYTES = 4 * 2**30
"""Most memory that the frames of one capture may take."""


def read_capture(
    path: Path,
    video: Video,
    *,
    fps: float = 1.0,
    max_long_side: int = 1600,
    start_s: float = 0.0,
    end_s: float | None = None,
    ignore_dir: Path | None = None,
    progress: Progress = silent,
) -> Capture:
    """Read a video file, a folder of pictures, or one picture.

    Parameters
    ----------
    fps : float
        Frames per second to take of a video: those nearest to ``start_s + k / fps``. Photos are
        all taken, in natural order of their names.
    max_long_side : int
        Frames are averaged down to this longer side, in pixels.
    start_s, end_s : float
        Part of a video to use, in seconds after its first frame; the end is not included.
    ignore_dir : Path
        Folder of mask pictures, not zero where the scene is hidden by something dynamic. A photo's
        mask has the photo's name up to the suffix; a video frame's mask has the number of the
        sampled frame (``0.png``, ``000012.png``). Frames without a mask are used whole.

    Returns
    -------
    Capture
        At least one frame; `warnings` say what was odd but could be lived with.

    Raises
    ------
    InputError
        If something that was given cannot be used; one sentence that names the file.
    """
    sampling = Sampling(fps, start_s, end_s)
    if max_long_side < MIN_SIDE:
        raise InputError(f"The long side must be at least {MIN_SIDE} pixels, not {max_long_side}.")
    warnings: list[str] = []
    is_video, pictures = _pictures(
        path,
        sampling,
        max_long_side,
        warnings.append,
        lambda done, total: progress(f"read {video}", done, total),
    )
    masks = _Masks(ignore_dir, by_number=is_video) if ignore_dir is not None else None
    frames = _frames(pictures, video, masks)
    if not frames:
        raise _no_pictures(path)
    _check_blank(path, frames, warnings.append)
    if masks and not any(f.ignore is not None for f in frames):
        wanted = "0.png, 1.png, …" if is_video else f"{Path(frames[0].name).stem}.png"
        warnings.append(f"No mask in {ignore_dir} belongs to a frame; expected names are {wanted}.")
    return Capture(video, str(path), frames, tuple(warnings))


def fingerprint(path: Path) -> str:
    """SHA-256 over the names, sizes and contents of the files that `read_capture` could read.

    For a folder: every file directly in it that is not hidden. Dates and places do not count, so
    a copy has the same fingerprint.

    Raises
    ------
    InputError
        If a file is missing or cannot be read.
    """
    _check_exists(path)
    files = [p for p in sorted_folder(path) if p.is_file()] if path.is_dir() else [path]
    digest = hashlib.sha256()
    for file in files:
        try:
            with file.open("rb") as stream:
                content = hashlib.file_digest(stream, "sha256").hexdigest()
            size = file.stat().st_size
        except OSError as error:
            raise InputError(f"{file} cannot be read: {error.strerror}.") from error
        digest.update(f"{file.name}\0{size}\0{content}\0".encode(errors="surrogateescape"))
    return digest.hexdigest()


def _check_exists(path: Path) -> None:
    try:
        path.stat()
    except FileNotFoundError as error:
        raise InputError(f"{path} does not exist.") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read: {error}.") from error
    if not (path.is_file() or path.is_dir()):
        raise InputError(f"{path} is neither a file nor a folder.")


def _pictures(
    path: Path,
    sampling: Sampling,
    max_long_side: int,
    warn: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> tuple[bool, Iterator[Picture]]:
    """Whether `path` is a video, and its pictures."""
    _check_exists(path)
    refuse_camera_format(path)
    if path.is_file() and not is_photo(path) and path.suffix.lower() not in PHOTO_SUFFIXES:
        return True, read_clip(path, sampling, max_long_side, warn, progress)
    if not sampling.whole:
        raise InputError(f"{path} is no video, so that no range in seconds can be taken from it.")
    paths = list_photos(path, warn) if path.is_dir() else [path]
    return False, read_photos(paths, max_long_side, progress)


def _frames(pictures: Iterator[Picture], video: Video, masks: "_Masks | None") -> tuple[Frame, ...]:
    frames: list[Frame] = []
    total = 0
    for index, picture in enumerate(pictures):
        total += picture.image.nbytes
        if total > MAX_CAPTURE_BYTES:
            raise InputError(
                f"The {video} capture takes more than {MAX_CAPTURE_BYTES / 2**30:.0f} GiB after "
                f"{index} frames: use a lower frame rate, fewer photos or a smaller long side."
            )
        frames.append(
            Frame(
                video=video,
                index=index,
                name=picture.name,
                time_s=picture.time_s,
                image=picture.image,
                width=picture.width,
                height=picture.height,
                focal_px=picture.focal_px,
                ignore=masks.of(picture, index) if masks else None,
            )
        )
    return tuple(frames)


def _check_blank(path: Path, frames: tuple[Frame, ...], warn: Callable[[str], None]) -> None:
    blank = [frame.name for frame in frames if is_blank(frame.image)]
    if len(blank) == len(frames):
        what = "is" if len(frames) == 1 else f"holds {len(frames)} frames, all"
        raise InputError(f"{path} {what} entirely black or of one colour: nothing can be seen.")
    if blank:
        listed = ", ".join(blank[:3]) + (", …" if len(blank) > 3 else "")
        warn(f"{path}: {len(blank)} frame(s) are entirely black or of one colour ({listed}).")


def _no_pictures(folder: Path) -> InputError:
    """Say what a folder without pictures holds instead."""
    entries = sorted_folder(folder)
    if not entries:
        return InputError(f"{folder} is an empty folder: give a video or a folder of pictures.")
    if clips := [p for p in entries if p.suffix.lower() in VIDEO_SUFFIXES]:
        return InputError(f"{folder} holds videos, not pictures: give one video, as {clips[0]}.")
    return InputError(f"{folder} holds no pictures: give a video or a folder of pictures.")


class _Masks:
    """The mask pictures of a folder, found by frame."""

    def __init__(self, folder: Path, *, by_number: bool) -> None:
        if not folder.is_dir():
            raise InputError(f"{folder} is not a folder of mask pictures.")
        self._by_number = by_number
        paths = [p for p in sorted_folder(folder) if p.suffix.lower() in PHOTO_SUFFIXES]
        self._paths: dict[str, Path] = {self._key(p.stem): p for p in paths}

    def of(self, picture: Picture, index: int) -> Bool[np.ndarray, "h w"] | None:
        """The mask at the picture's working size; None where there is none."""
        path = self._paths.get(str(index) if self._by_number else Path(picture.name).stem)
        if path is None:
            return None
        mask = read_mask(path)
        height, width = mask.shape
        skew = abs(width * picture.height - height * picture.width)
        if skew > max(picture.width, picture.height):  # a reduced mask's size may be rounded
            raise InputError(
                f"{path} has {width} x {height} pixels, which is another shape than that of "
                f"{picture.name} ({picture.width} x {picture.height}, upright)."
            )
        size = picture.image.shape[1], picture.image.shape[0]
        return cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0

    def _key(self, stem: str) -> str:
        return str(int(stem)) if self._by_number and stem.isdecimal() else stem
