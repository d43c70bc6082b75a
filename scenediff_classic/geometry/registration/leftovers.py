"""Pictures that mapping left out, placed by the points that their matches say they see.

A picture must see many points of the model, in one arrangement and over much of its area: matches
by chance, single things that moved and repeated patterns do not offer that.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64, Int64

from scenediff_classic.geometry.registration.colmap.database import Database
from scenediff_classic.geometry.registration.colmap.growing import (
    complete,
    feature_matches,
    find_pose,
    first_lens,
    keypoints,
    write_grown,
)
from scenediff_classic.geometry.registration.colmap.models import read_model
from scenediff_classic.geometry.registration.placement import CELLS
from scenediff_classic.geometry.registration.quality import video_of
from scenediff_classic.geometry.registration.refinement import refine
from scenediff_classic.geometry.registration.sparse_model import (
    FeatureMatches,
    PosedPicture,
    SparseModel,
    points_of_features,
    project_points,
)
from scenediff_classic.types import Lens, SparsePoints

MAX_MISS = 0.006
"""Distance in the picture, as a share of its longer side, at which a point is seen."""
MIN_SEEN = 20
"""Points that a picture must see. Pictures of another scene agreed on at most 13 (the thorough
recipe, four PASLCD scenes offered to each other)."""
MIN_SHARE = 0.5
"""Share of the offered points that it must see. Of right ones 0.94 and more agreed (0.88 where a
single other picture offered them), of up to 139 offered to pictures of another scene a tenth."""
MIN_COVER = 0.3
"""Share of the cells of a picture that must hold points. By the matches with a single other
picture, 2 of 24 cameras that rest on 20 to 29 points in at most a quarter of the cells were more
than 2 percent of the path off, of 403 with more cells none. A poster that shows a part of the scene
is seen in few cells as well."""
MAX_SECOND = 0.5
"""Largest part of what agrees on the best camera that may agree on another one. Between pictures of
different scenes the second one is about as good as the first."""
ROUNDS = 5
"""A picture that was placed may bring points that place another one."""


@dataclass(frozen=True)
class Sighting:
    """A left-out picture's camera, and what speaks for it."""

    picture: PosedPicture
    seen: Int64[np.ndarray, "k 2"]
    """(feature of the picture, point of the model) that agree on the camera."""
    offered: int
    """Features that matches say are points of the model."""
    cover: float
    """Share of the picture's cells that hold one of those seen."""
    second: int
    """How many of those not seen agree on the next best camera."""

    @property
    def firm(self) -> bool:
        """True if the camera is neither a matter of chance nor one of two that are as likely."""
        agree = len(self.seen)
        enough = agree >= max(MIN_SEEN, MIN_SHARE * self.offered)
        return enough and self.cover >= MIN_COVER and self.second <= MAX_SECOND * agree


def place_leftovers(
    folder: Path, database: Database, output: Path, *, lens: bool
) -> tuple[Path, tuple[str, ...]]:
    """Place pictures that a model lacks; the folder of the result, and their names.

    Parameters
    ----------
    folder : Path
        A model under the database's numbers; it stays as it is.
    output : Path
        Folder below which results are written.
    lens : bool
        Refine focal length and distortion in the adjustment that follows.
    """
    names = [picture.name for picture in database.pictures]
    model = read_model(folder)
    held = {picture.name for picture in model.pictures}
    placed: list[str] = []
    if len(held) == len(names):
        return folder, ()
    matches, found = feature_matches(database), keypoints(database)
    for number in range(ROUNDS):
        sightings = [
            sighting
            for name in names
            if name not in held and (sighting := _sight(name, model, database, matches, found))
        ]
        if not sightings:
            break
        placed += [sighting.picture.name for sighting in sightings]
        grown = write_grown(with_sightings(model, sightings, found), output / str(number), database)
        grown = complete(grown, output / f"{number}-completed", database)
        folder, _ = refine(grown, output / f"{number}-refined", lens=lens)
        model = read_model(folder)
        held |= set(placed)
    return folder, tuple(sorted(placed))


def offers(
    name: str, points: Mapping[str, Mapping[int, int]], matches: Sequence[FeatureMatches]
) -> Int64[np.ndarray, "n 2"]:
    """(feature of a picture, point of the model) that matches say it is; each feature once.

    Parameters
    ----------
    points : mapping
        Which point each feature of each picture of the model is: see `points_of_features`.
    """
    votes: Counter[tuple[int, int]] = Counter()
    for match in (*matches, *(match.swapped() for match in matches)):
        known = points.get(match.second, {})
        if match.first == name and known:
            pairs = match.features.tolist()
            votes.update((here, known[there]) for here, there in pairs if there in known)
    best: dict[int, int] = {}
    for (feature, point), _ in sorted(votes.items(), key=lambda vote: (-vote[1], vote[0])):
        best.setdefault(feature, point)
    return np.array(sorted(best.items()), np.int64).reshape(-1, 2)


def sight(
    name: str,
    lens: Lens,
    offered: Int64[np.ndarray, "n 2"],
    xy: Float64[np.ndarray, "f 2"],
    xyz: Float64[np.ndarray, "p 3"],
    seed: int = 0,
    *,
    refine_lens: bool = False,
) -> Sighting | None:
    """The camera that most of the offered points agree on; None if there is none.

    Parameters
    ----------
    xy : array (features, 2)
        Where the picture's features are, in pixels.
    xyz : array (points, 3)
        The points of the model.
    refine_lens : bool
        The lens is a guess: refine it.
    """
    if len(offered) < MIN_SEEN:
        return None
    miss = MAX_MISS * max(lens.width, lens.height)
    pixels, points = xy[offered[:, 0]], xyz[offered[:, 1]]
    found = find_pose(pixels, points, lens, miss, seed, refine_lens=refine_lens)
    if found is None:
        return None
    pose, lens, agree = found
    picture = PosedPicture(name, lens, pose)
    away = np.linalg.norm(project_points(points, picture) - pixels, axis=1)
    rest = ~(away < 2 * miss)  # behind the camera is NaN, and away as well
    other = find_pose(pixels[rest], points[rest], lens, miss, seed) if rest.sum() > 3 else None
    seen = offered[agree]
    seen = seen[np.unique(seen[:, 1], return_index=True)[1]]  # a picture sees a point once only
    where = xy[seen[:, 0]] / [lens.width, lens.height] * CELLS
    cells = np.clip(where, 0, CELLS - 1).astype(int)
    cover = len(np.unique(cells, axis=0)) / CELLS**2
    second = 0 if other is None else int(other[2].sum())
    return Sighting(picture, seen, len(offered), cover, second)


def with_sightings(
    model: SparseModel,
    sightings: Sequence[Sighting],
    found: Mapping[str, Float64[np.ndarray, "f 2"]],
) -> SparseModel:
    """The model with further pictures, and with what they see of its points.

    Parameters
    ----------
    found : mapping
        Where the features of each picture are, in pixels.
    """
    assert model.keypoints is not None
    assert model.features is not None
    added = sorted(sightings, key=lambda s: s.picture.name)
    pictures = sorted((*model.pictures, *(s.picture for s in added)), key=lambda p: p.name)
    place = {picture.name: number for number, picture in enumerate(pictures)}
    moved = np.array([place[p.name] for p in model.pictures], np.int64)
    point, picture = model.points.observations.T
    rows = [np.column_stack([point, moved[picture], model.features])]
    for s in added:
        here = np.full(len(s.seen), place[s.picture.name])
        rows.append(np.column_stack([s.seen[:, 1], here, s.seen[:, 0]]))
    where = [model.keypoints, *(found[s.picture.name][s.seen[:, 0]] for s in added)]
    table, keypoints_there = np.concatenate(rows), np.concatenate(where)
    order = np.lexsort((table[:, 1], table[:, 0]))
    points = SparsePoints(model.points.xyz, model.points.rgb, table[order, :2])
    return replace(
        model,
        pictures=tuple(pictures),
        points=points,
        keypoints=keypoints_there[order],
        features=table[order, 2],
    )


def _sight(
    name: str,
    model: SparseModel,
    database: Database,
    matches: Sequence[FeatureMatches],
    found: Mapping[str, Float64[np.ndarray, "f 2"]],
) -> Sighting | None:
    """The firm camera of a picture, preferably by its own capture, within which nothing moves."""
    camera = {picture.name: picture.camera for picture in database.pictures}
    shared = [p.lens for p in model.pictures if camera[p.name] == camera[name]]
    lens = shared[0] if shared else first_lens(database, name)
    points = points_of_features(model)
    own = {other: seen for other, seen in points.items() if video_of(other) == video_of(name)}
    for chosen in (own, points):
        offered = offers(name, chosen, matches)
        sighting = sight(
            name, lens, offered, found[name], model.points.xyz, database.seed,
            refine_lens=not shared,
        )  # fmt: skip
        if sighting is not None and sighting.firm:
            return sighting
    return None
