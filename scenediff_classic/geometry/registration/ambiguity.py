"""Is there another way to lay the captures over each other than the one that was found?

Each capture is reconstructed alone, from the same matches, and the two models are laid over each
other in all possible ways (`alignments`). A strong second one means that much moved as one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from scenediff_classic.geometry.registration.alignments import (
    AMBIGUOUS,
    alignments,
    ground_share,
    looks_of,
)
from scenediff_classic.geometry.registration.colmap.database import Database
from scenediff_classic.geometry.registration.colmap.growing import write_grown
from scenediff_classic.geometry.registration.colmap.models import read_model
from scenediff_classic.geometry.registration.joining import join
from scenediff_classic.geometry.registration.ladder import Rung
from scenediff_classic.geometry.registration.quality import judge, video_of
from scenediff_classic.geometry.registration.refinement import refine
from scenediff_classic.geometry.registration.sparse_model import SparseModel
from scenediff_classic.types import VIDEOS, Video

OWN_FRAMES = 0.8
"""Share of a capture's frames that must hang together by themselves, or nothing can be said."""
MIN_PICTURES = 3
"""A capture of fewer pictures has no model of its own to speak of."""


@dataclass(frozen=True)
class Verdict:
    """What the captures' own models say of the joint one."""

    model: Path | None = None
    """Folder of the model that replaces the joint one; None = the joint one stays."""
    log: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def check_alignment(
    database: Database, rung: Rung, folder: Path, usable: Mapping[Video, int]
) -> Verdict:
    """Look for a second way to lay the captures over each other.

    Parameters
    ----------
    rung : Rung
        The attempt that made the joint model: the captures are reconstructed the same way.
    folder : Path
        Where the captures' own models are written.
    usable : mapping
        How many frames of each capture can be placed.
    """
    own = _own_models(database, rung, folder)
    if own is None:
        return Verdict()
    before, after = own
    looks = [looks_of(m, database.descriptors([p.name for p in m.pictures])) for m in own]
    ways = alignments(before, after, looks[0], looks[1], database.seed)
    if not ways:
        return Verdict()
    share = ground_share(ways)
    counts = [len(way.pairs) for way in ways]
    line = f"{counts[0]} points agree on the alignment"
    if len(counts) > 1:
        line += f", {counts[1]} on one other motion ({share:.0%})"
    log = (f"Captures reconstructed apart and laid over each other: {line}.",)
    if share < AMBIGUOUS:
        return Verdict(log=log)
    warning = (
        "The alignment of before and after is ambiguous: much of the scene moved by one and the "
        f"same motion ({share:.0%} of what both captures show, or all but that), and what is "
        "reported as moved may be what stayed."
    )
    # the joint model took its matches from what stayed and from what moved, and may be bent
    joined = write_grown(
        join(before, after, ways[0].motion, ways[0].pairs), folder / "joined", database
    )
    model, _ = refine(joined, folder / "joined-refined", lens=False)
    quality = judge(read_model(model), usable)
    if not quality.aligned:
        return Verdict(None, log, (warning,))
    return Verdict(
        model,
        (*log, f"The captures' own models replace the joint one: {quality}."),
        (f"{warning} What lies farther away was taken for what stayed.",),
    )


def _own_models(
    database: Database, rung: Rung, folder: Path
) -> tuple[SparseModel, SparseModel] | None:
    """A model of each capture alone; None where there is none to rely on."""
    if rung.mapper.method == "global" or rung.features.weights is not None:
        return None  # global mapping takes all pictures; looks are told by SIFT descriptors
    names = [[p.name for p in database.pictures if video_of(p.name) == v] for v in VIDEOS]
    if min(map(len, names)) < MIN_PICTURES:
        return None
    found = []
    for video, pictures in zip(VIDEOS, names, strict=True):
        models = database.reconstruct(folder / video, rung.mapper, lambda n: None, pictures)
        if not models:
            return None
        refined, _ = refine(models[0], folder / f"{video}-refined", lens=True)
        own = read_model(refined)
        if len(own.pictures) < OWN_FRAMES * len(pictures):
            return None
        found.append(own)
    before, after = found
    return before, after
