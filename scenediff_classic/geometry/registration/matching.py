"""From pictures to verified matches: features, which pairs to match, where mapping starts from."""

import itertools
import os
from collections.abc import Sequence

from scenediff_classic.geometry.registration.colmap.database import Database
from scenediff_classic.geometry.registration.focal import vote_focal
from scenediff_classic.geometry.registration.pairing import matching_pairs
from scenediff_classic.geometry.registration.sfm_workspace import SfmWorkspace
from scenediff_classic.geometry.registration.sparse_model import FeatureRecipe, Picture
from scenediff_classic.protocols import Progress
from scenediff_classic.types import VIDEOS

FEATURES_AT_ONCE, PAIRS_AT_ONCE = 8, 200
"""Between two reports of progress."""


def matched(
    pictures: Sequence[Picture],
    recipe: FeatureRecipe,
    files: SfmWorkspace,
    seed: int,
    progress: Progress,
) -> Database:
    """The database of a recipe: made once, then shared by all rungs that use it."""
    final = Database(files.folder / f"{recipe.name}.db", files.images, tuple(pictures), seed)
    if final.path.exists():
        return final
    path = final.path.with_suffix(".part")
    path.unlink(missing_ok=True)
    database = Database(path, files.images, final.pictures, seed)
    database.create()
    names = [picture.name for picture in pictures]
    for start in range(0, len(names), FEATURES_AT_ONCE):
        progress("features", start, len(names))
        database.extract(names[start : start + FEATURES_AT_ONCE], files.masks, recipe)
    pairs = _pairs(names, database, recipe)
    for start in range(0, len(pairs), PAIRS_AT_ONCE):
        progress("matching", start, len(pairs))
        database.match(pairs[start : start + PAIRS_AT_ONCE], recipe)
    progress("matching", len(pairs), len(pairs))
    _start_focal(database)
    os.replace(path, final.path)
    return final


def _pairs(
    names: Sequence[str], database: Database, recipe: FeatureRecipe
) -> list[tuple[str, str]]:
    if recipe.weights is not None:  # look-alikes are told by SIFT descriptors
        return list(itertools.combinations(names, 2))
    captures = [[name for name in names if name.startswith(video)] for video in VIDEOS]
    return matching_pairs(captures, database, database.seed)


def _start_focal(database: Database) -> None:
    """Let the matches say where mapping starts from, for cameras without a known focal length."""
    sides = {p.camera: (p.focal, max(p.width, p.height)) for p in database.pictures}
    known = {camera: focal / side for camera, (focal, side) in sides.items() if focal is not None}
    if len(known) < len(sides):
        database.set_focal(vote_focal(database.epipolar_pairs(), known, tuple(sides)))
