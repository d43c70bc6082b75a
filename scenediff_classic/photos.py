"""Still pictures: any common format, depth and colour mode, with EXIF orientation and focal."""

import math
import re
import unicodedata
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8
from PIL import ExifTags, Image, UnidentifiedImageError

from scenediff_classic.errors import InputError
from scenediff_classic.pictures import Picture, Turn, check_size, shrink

# fmt: off
PHOTO_SUFFIXES = frozenset((
    ".jpg", ".jpeg", ".jpe", ".jfif", ".png", ".tif", ".tiff", ".webp", ".bmp", ".ppm", ".pgm",
    ".pnm", ".gif", ".jp2", ".avif",
))
CAMERA_SUFFIXES = frozenset((
    ".heic", ".heif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2",
))
# fmt: on
"""Pictures that Pillow cannot read, or of which it would read only the thumbnail."""

# Pillow knows more formats, but some of those run other programs (EPS) or claim videos (MPEG).
_FORMATS = ("JPEG", "MPO", "PNG", "TIFF", "WEBP", "BMP", "PPM", "GIF", "JPEG2000", "AVIF")

_ORIENTATION = {  # Exif 2.32, tag 0x0112
    1: Turn(),
    2: Turn(mirror_x=True),
    3: Turn(mirror_x=True, mirror_y=True),
    4: Turn(mirror_y=True),
    5: Turn(transpose=True),
    6: Turn(transpose=True, mirror_x=True),
    7: Turn(transpose=True, mirror_x=True, mirror_y=True),
    8: Turn(transpose=True, mirror_y=True),
}

_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}  # FocalPlaneResolutionUnit
_FILM_DIAGONAL_MM = math.hypot(36, 24)


def natural_key(name: str) -> tuple[tuple[str | int, ...], str]:
    """Sort key under which ``img2`` comes before ``img10``, whatever the letters' case."""
    parts = re.split("([0-9]+)", unicodedata.normalize("NFC", name).casefold())
    return tuple(int(p) if i % 2 else p for i, p in enumerate(parts)), name


def list_photos(folder: Path, warn: Callable[[str], None]) -> list[Path]:
    """The pictures directly in a folder, in natural order of their names.

    Hidden files and subfolders are left out silently, other files with one warning. A raw or
    HEIC file is left out where a readable picture of the same name lies beside it.

    Raises
    ------
    InputError
        If a raw or HEIC picture stands alone, since it cannot be read.
    """
    files = [p for p in sorted_folder(folder) if p.is_file()]
    photos = [p for p in files if p.suffix.lower() in PHOTO_SUFFIXES]
    stems = {p.stem for p in photos}
    camera = [p for p in files if p.suffix.lower() in CAMERA_SUFFIXES]
    if lonely := [p for p in camera if p.stem not in stems]:
        refuse_camera_format(lonely[0])
    taken = {*photos, *camera}
    if photos and (others := [p.name for p in files if p not in taken]):
        listed = ", ".join(others[:3]) + (", …" if len(others) > 3 else "")
        warn(f"{folder}: left out {len(others)} file(s) that are no pictures ({listed}).")
    return photos


def refuse_camera_format(path: Path) -> None:
    """Raise `InputError` for raw and HEIC pictures, told by their names."""
    if path.suffix.lower() in CAMERA_SUFFIXES:
        kind = path.suffix[1:].upper()
        raise InputError(
            f"{path} is a {kind} picture, which cannot be read here: convert it to JPEG or PNG."
        )


def sorted_folder(folder: Path) -> list[Path]:
    """Everything in a folder that is not hidden, in natural order.

    Raises
    ------
    InputError
        If the folder cannot be listed.
    """
    try:
        entries = [p for p in folder.iterdir() if not p.name.startswith(".")]
    except OSError as error:
        raise InputError(f"{folder} cannot be listed: {error.strerror}.") from error
    return sorted(entries, key=lambda p: natural_key(p.name))


def is_photo(path: Path) -> bool:
    """Whether a file holds a still picture, told by its content rather than its name."""
    try:
        with _quiet(), Image.open(path, formats=_formats()) as picture:
            return picture.width > 0
    except Image.DecompressionBombError:
        return True
    except Exception:  # broken headers make Pillow's parsers raise almost anything
        return False


def read_photo(path: Path, max_long_side: int) -> Picture:
    """Read a picture upright as 8-bit RGB, reduced to `max_long_side`.

    Alpha is dropped, 16-bit values are scaled by 1/257 (colour: cut to their upper 8 bits, which
    differs by at most one level), palettes and CMYK are converted. Colour profiles are ignored.

    Raises
    ------
    InputError
        If the file cannot be read, or holds no picture that can be used; names the file.
    """
    pixels, exif = _decode(path, _to_rgb)
    height, width = pixels.shape[:2]
    turn = _ORIENTATION.get(exif.get(ExifTags.Base.Orientation, 1), Turn())
    upright_width, upright_height = turn.size(width, height)
    return Picture(
        name=path.name,
        image=turn.apply(shrink(pixels, max_long_side)),
        width=upright_width,
        height=upright_height,
        focal_px=focal_from_exif(exif, width, height),
    )


def read_photos(
    paths: Sequence[Path], max_long_side: int, progress: Callable[[int, int], None]
) -> Iterator[Picture]:
    """Pictures, one by one; see `read_photo`."""
    for done, path in enumerate(paths, start=1):
        yield read_photo(path, max_long_side)
        progress(done, len(paths))


def read_mask(path: Path) -> Bool[np.ndarray, "h w"]:
    """Read a mask picture: True where a pixel (or its palette index) is not zero; alpha is dropped.

    Raises
    ------
    InputError
        If the file cannot be read as a picture; names the file.
    """
    values, exif = _decode(path, _mask_values)
    turn = _ORIENTATION.get(exif.get(ExifTags.Base.Orientation, 1), Turn())
    return turn.apply(np.asarray(np.atleast_3d(values).any(axis=2)))


def focal_from_exif(exif: Image.Exif, width: int, height: int) -> float | None:
    """Focal length in pixels from EXIF, or None where it is unknown or cannot be trusted.

    The 35 mm equivalent compares picture diagonals (CIPA DCG-001), so that it holds for 4:3
    pictures as well; without one, focal length and sensor resolution are used. Cropped and
    digitally zoomed pictures have none.

    Parameters
    ----------
    width, height : int
        Size of the picture as stored, in pixels.
    """
    tags = exif.get_ifd(ExifTags.IFD.Exif)
    full_width = _positive(tags.get(ExifTags.Base.ExifImageWidth)) or width
    full_height = _positive(tags.get(ExifTags.Base.ExifImageHeight)) or height
    cropped = abs(full_width * height / (full_height * width) - 1) > 0.01
    zoom = _positive(tags.get(ExifTags.Base.DigitalZoomRatio)) or 1.0
    if cropped or zoom > 1.01:
        return None
    focal = None
    if film := _positive(tags.get(ExifTags.Base.FocalLengthIn35mmFilm)):
        focal = film / _FILM_DIAGONAL_MM * math.hypot(width, height)
    else:
        length = _positive(tags.get(ExifTags.Base.FocalLength))
        density = _positive(tags.get(ExifTags.Base.FocalPlaneXResolution))
        unit = _MM_PER_UNIT.get(tags.get(ExifTags.Base.FocalPlaneResolutionUnit, 2))
        if length and density and unit:
            focal = length * density / unit * width / full_width
    longer = max(width, height)
    return focal if focal and 0.2 * longer < focal < 20 * longer else None


def _positive(value: Any) -> float | None:
    """A tag's value as a number above zero, or None: EXIF is full of nonsense."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number > 0 else None


def _decode(
    path: Path, pixels_of: Callable[[Image.Image], np.ndarray]
) -> tuple[np.ndarray, Image.Exif]:
    """Open, check and decode one file; every failure becomes one sentence."""
    try:
        if path.stat().st_size == 0:
            raise InputError(f"{path} is empty (0 bytes).")
        with _quiet(), Image.open(path, formats=_formats()) as picture:
            check_size(*picture.size, what=str(path))
            picture.load()
            return pixels_of(picture), _exif(picture)
    except (InputError, MemoryError):
        raise
    except Image.DecompressionBombError as error:
        raise InputError(f"{path} has too many pixels to be read: make it smaller.") from error
    except UnidentifiedImageError as error:
        raise InputError(f"{path} is not a picture, or its head is damaged.") from error
    except (FileNotFoundError, PermissionError) as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from error
    except Exception as error:  # broken data make Pillow's decoders raise almost anything
        raise InputError(f"{path} is a damaged picture ({error}): remove or replace it.") from error


def _to_rgb(picture: Image.Image) -> UInt8[np.ndarray, "h w 3"]:
    """8-bit RGB of any mode."""
    if picture.mode == "F":
        raise ValueError("it holds floating-point values; 8 or 16 bits are needed")
    if picture.mode == "I" or picture.mode.startswith("I;16"):
        values = np.asarray(picture)
        if values.min() < 0 or values.max() > 65535:
            raise ValueError("it holds 32-bit values; 8 or 16 bits are needed")
        grey = np.rint(values / np.float32(257)).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=2)
    if picture.mode in ("P", "PA"):  # Pillow warns when transparency would get lost on the way
        picture = picture.convert("RGBA")
    return np.asarray(picture if picture.mode == "RGB" else picture.convert("RGB"))


def _mask_values(picture: Image.Image) -> np.ndarray:
    """Raw values without alpha; palette indices stay indices."""
    values = np.asarray(picture)
    return values[..., :-1] if picture.mode in ("RGBA", "RGBa", "LA", "La", "PA") else values


def _exif(picture: Image.Image) -> Image.Exif:
    """The picture's EXIF (read after decoding, as some formats turn themselves); may be empty."""
    try:
        exif = picture.getexif()
        exif.get_ifd(ExifTags.IFD.Exif)
    except Exception:  # a broken EXIF block must not cost the picture
        return Image.Exif()
    return exif


def _formats() -> list[str]:
    """The wanted formats that this build of Pillow knows."""
    Image.init()
    return [name for name in _FORMATS if name in Image.OPEN]


def _quiet() -> warnings.catch_warnings:
    """Silence Pillow's warnings on odd metadata and large pictures (`check_size` guards those)."""
    return warnings.catch_warnings(action="ignore")
