"""Models of some pictures each, made one where the matches between their pictures agree on how.

The mapper gives up on a picture that fewer than a few dozen points hold, and begins a model anew.
Between two whole models all their pictures speak together: a match between two pictures, one of
each, whose features both became points says that these points are one, and three such pairs fix
how one model lies over the other.
"""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from scenediff_classic.geometry.registration.colmap.database import Database
from scenediff_classic.geometry.registration.colmap.growing import (
    complete,
    feature_matches,
    write_grown,
)
from scenediff_classic.geometry.registration.colmap.models import read_model
from scenediff_classic.geometry.registration.joining import join
from scenediff_classic.geometry.registration.refinement import refine
from scenediff_classic.geometry.registration.similarity import (
    MIN_PAIRS,
    TOLERANCE,
    PointPairs,
    strongest,
)
from scenediff_classic.geometry.registration.sparse_model import (
    FeatureMatches,
    SparseModel,
    points_of_features,
    residuals,
)

MIN_SHARE = 0.5
"""Share of the matched points that must agree on one motion. Measured on captures reconstructed
apart: 0.94 to 1 of 20 to 811; between different scenes 4 of 81 at most."""
MAX_SECOND = 0.5
"""Largest part of what agrees on the best motion that may agree on another one: with repeated
things, or much that moved as one, nothing tells which is right. Measured: 0 where one is right,
and as many as on the best where none is."""


@dataclass(frozen=True)
class Tie:
    """How one model lies over another."""

    motion: Float64[np.ndarray, "4 4"]
    """Similarity from the first model's world to the second's."""
    pairs: Int64[np.ndarray, "k 2"]
    """(point of the first, point of the second) that agree on it."""
    tried: int
    """Pairs of points that matches say are one."""
    second: int
    """How many of those left over agree on the next best motion."""

    @property
    def firm(self) -> bool:
        """True if the motion is neither a matter of chance nor one of two that are as likely."""
        agree = len(self.pairs)
        enough = agree >= max(MIN_PAIRS, MIN_SHARE * self.tried)
        return enough and self.second <= MAX_SECOND * agree


def merge(models: Sequence[Path], database: Database, output: Path) -> tuple[Path, ...]:
    """Join what can be joined firmly; the joined models, none if nothing fits.

    Parameters
    ----------
    models : sequence of Path
        Models of the database's pictures, largest first.
    output : Path
        Folder below which results are written.
    """
    matches = feature_matches(database)
    left, joined = list(models), []
    while left:
        target, others = left[0], left[1:]
        left = others
        for other in others:
            made = _merged(other, target, matches, database, output / str(len(others)))
            if made is not None:
                left = [made, *(model for model in others if model != other)]
                joined = [model for model in joined if model != target] + [made]
                break
    return tuple(joined)


def tie(
    first: SparseModel, second: SparseModel, matches: Sequence[FeatureMatches], seed: int = 0
) -> Tie:
    """The motion that most matched points agree on, and how it compares to the next best."""
    rng = np.random.default_rng(seed)
    pairs = matched_points(first, second, matches)
    test = PointPairs.of(first, second, pairs)
    motion, agree = strongest(test, rng)
    rest = pairs[~test.follows(motion[None], 2.0)[0]] if agree.any() else pairs[:0]
    _, next_best = strongest(PointPairs.of(first, second, rest), rng)
    return Tie(motion, pairs[agree], len(pairs), int(next_best.sum()))


def matched_points(
    first: SparseModel, second: SparseModel, matches: Sequence[FeatureMatches]
) -> Int64[np.ndarray, "k 2"]:
    """(point of the first model, point of the second) that matches say are one.

    Each point is in one pair at most, that which most matches speak for. A picture that both
    models hold speaks as if each of its features were matched with itself.
    """
    ones, others = points_of_features(first), points_of_features(second)
    votes: Counter[tuple[int, int]] = Counter()
    for name in ones.keys() & others.keys():
        both = ones[name].keys() & others[name].keys()
        votes.update((ones[name][feature], others[name][feature]) for feature in both)
    for match in (*matches, *(match.swapped() for match in matches)):
        here, there = ones.get(match.first, {}), others.get(match.second, {})
        if here and there:
            pairs = match.features.tolist()
            votes.update((here[f], there[g]) for f, g in pairs if f in here and g in there)
    found: dict[int, int] = {}
    taken: set[int] = set()
    for (a, b), _ in sorted(votes.items(), key=lambda vote: (-vote[1], vote[0])):
        if a not in found and b not in taken:
            found[a] = b
            taken.add(b)
    return np.array(sorted(found.items()), np.int64).reshape(-1, 2)


def seam(model: SparseModel, one: Collection[str], other: Collection[str]) -> int:
    """How many points pictures of both groups see where they are."""
    sides = np.array([max(p.lens.width, p.lens.height) for p in model.pictures])
    point, picture = model.points.observations.T
    good = np.linalg.norm(residuals(model), axis=1) < TOLERANCE * sides[picture]
    seen = np.zeros((2, len(model.points.xyz)), bool)
    for side, group in zip(seen, (one, other), strict=True):
        member = np.array([p.name in group for p in model.pictures], bool)
        side[point[good & member[picture]]] = True
    return int(seen.all(axis=0).sum())


def _merged(
    moved: Path,
    target: Path,
    matches: Sequence[FeatureMatches],
    database: Database,
    output: Path,
) -> Path | None:
    """One model laid over another, completed and adjusted; None if they do not hold together."""
    first, second = read_model(moved), read_model(target)
    here, there = ({p.name for p in model.pictures} for model in (first, second))
    if here <= there:
        return None
    found = tie(first, second, matches, database.seed)
    if not found.firm:
        return None
    joint = join(_with_lenses(first, second, database), second, found.motion, found.pairs)
    folder = write_grown(joint, output / "joined", database)
    folder = complete(folder, output / "completed", database)
    folder, _ = refine(folder, output / "refined", lens=True)
    held = seam(read_model(folder), here - there, there)
    return folder if held >= max(MIN_PAIRS, MIN_SHARE * len(found.pairs)) else None


def _with_lenses(moved: SparseModel, target: SparseModel, database: Database) -> SparseModel:
    """The moved model with the target's lenses, wherever they share a camera."""
    camera = {picture.name: picture.camera for picture in database.pictures}
    known = {camera[picture.name]: picture.lens for picture in target.pictures}
    pictures = (replace(p, lens=known.get(camera[p.name], p.lens)) for p in moved.pictures)
    return replace(moved, pictures=tuple(pictures))
