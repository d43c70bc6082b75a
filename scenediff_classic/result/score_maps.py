"""``scores/``: what each view says for a change, as arrays for whoever wants to draw or count."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from scenediff_classic.errors import InputError
from scenediff_classic.types import ScoreMaps, Video, View
from scenediff_classic.workspace import load_npz, save_npz

TERMS = ("geometry", "feature", "region", "total")


def write_scores(views: Sequence[View], scores: Sequence[ScoreMaps], folder: Path) -> None:
    """Write ``<video>_<index>.npz`` for every view.

    Half precision: scores are between 0 and 1, and nobody tells 0.3001 from 0.3.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    for view, maps in zip(views, scores, strict=True):
        arrays = {term: getattr(maps, term).astype(np.float16) for term in TERMS}
        save_npz(score_file(folder, view.video, view.index), **arrays)


def read_scores(folder: Path, video: Video, index: int) -> ScoreMaps:
    """The score maps of one view.

    Raises
    ------
    InputError
        If they are missing or damaged.
    """
    path = score_file(folder, video, index)
    arrays = load_npz(path)
    if arrays is None or any(term not in arrays or arrays[term].ndim != 2 for term in TERMS):
        raise InputError(f"{path} does not hold score maps: run the detection again.")
    return ScoreMaps(*(arrays[term].astype(np.float32) for term in TERMS))


def score_file(folder: Path, video: Video, index: int) -> Path:
    """Where the maps of a view lie."""
    return folder / f"{video}_{index:05d}.npz"
