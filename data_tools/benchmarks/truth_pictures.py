"""Truth as one mask picture for each after picture, and pixels counted against it."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from PIL import Image

from scenediff_classic import masks
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.metrics import PixelCounts
from scenediff_classic.types import Rle


def read_mask_picture(path: Path, above: int = 127) -> Bool[np.ndarray, "h w"]:
    """True where any channel of a picture is above a level.

    Raises
    ------
    InputError
        It cannot be read.
    """
    try:
        with Image.open(path) as picture:
            mode = "L" if picture.mode in ("1", "L", "LA", "I;16", "I") else "RGB"
            values = np.asarray(picture.convert(mode))
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"{path} cannot be read as a mask picture.") from error
    return np.any(np.atleast_3d(values) > above, axis=-1)


def count(found: Rle | None, truth: Bool[np.ndarray, "h w"]) -> PixelCounts:
    """Pixels of a mask (None = nothing found) against the truth, at the truth's size."""
    changed = int(truth.sum())
    if found is None:
        return PixelCounts(missed=changed)
    if found.size != truth.shape:
        found = masks.resize(found, *truth.shape)
    hit = int((masks.decode(found) & truth).sum())
    return PixelCounts(hit, masks.area(found) - hit, changed - hit)


def counts_by_picture(
    truths: Mapping[str, Path],
    names: Mapping[int, str],
    found: Mapping[int, Rle],
    above: int = 127,
) -> tuple[PixelCounts, ...]:
    """Every truth picture against the mask found in the picture of the same name.

    Parameters
    ----------
    truths : mapping
        Stem of a picture's name -> its truth.
    names : mapping
        Sampled frame -> the picture's name.
    """
    by_stem = {Path(name).stem: found.get(index) for index, name in names.items()}
    return tuple(
        count(by_stem.get(stem), read_mask_picture(path, above)) for stem, path in truths.items()
    )


def iou(counts: PixelCounts) -> float | None:
    """None where nothing is to be found and nothing was."""
    return counts.hit / counts.total if counts.total else None


def f1(counts: PixelCounts) -> float | None:
    """Harmonic mean of precision and recall."""
    whole = 2 * counts.hit + counts.false + counts.missed
    return 2 * counts.hit / whole if whole else None


def mean(values: Iterable[float | None]) -> float | None:
    """Of those that are defined; None if none is."""
    known = [v for v in values if v is not None]
    return sum(known) / len(known) if known else None
