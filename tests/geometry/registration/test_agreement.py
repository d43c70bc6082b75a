"""Whether cameras stand where their matches say: with drawn cameras, and in the ladder."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scenediff_classic.geometry.registration.agreement import (
    MIN_MATCHES,
    OwnMatches,
    agreements,
    misses,
)
from scenediff_classic.geometry.registration.colmap.database import Database
from scenediff_classic.geometry.registration.colmap.growing import (
    feature_matches,
    own_matches,
    write_grown,
)
from scenediff_classic.geometry.registration.colmap.models import read_model
from scenediff_classic.geometry.registration.ladder import STANDARD
from scenediff_classic.geometry.registration.matching import matched
from scenediff_classic.geometry.registration.sfm_workspace import SfmWorkspace, write_pictures
from scenediff_classic.geometry.registration.sparse_model import (
    FeatureMatches,
    MapperRecipe,
    PosedPicture,
    SparseModel,
    project_points,
)
from scenediff_classic.geometry.registration.structure_from_motion import StructureFromMotion
from scenediff_classic.protocols import silent
from scenediff_classic.types import Lens, SparsePoints
from tests.geometry.cards import capture, sweep

LENS = Lens(320, 240, np.array([[300.0, 0, 165], [0, 310, 118], [0, 0, 1]]),
            np.array([-0.1, 0.02, 0.001, -0.001]))  # fmt: skip
TURNED = "before/00002.png"
NAMES = (*(f"after/{n:05d}.png" for n in range(2)), *(f"before/{n:05d}.png" for n in range(6)))


def turned(picture: PosedPicture, degrees: float) -> PosedPicture:
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([np.radians(degrees), 0, 0]).as_matrix()
    return replace(picture, cam_from_world=turn @ picture.cam_from_world)


@pytest.fixture
def right() -> tuple[SparseModel, OwnMatches]:
    """Eight cameras in front of 80 points, each matched between all; a pixel of noise."""
    rng = np.random.default_rng(0)
    pictures = []
    for name in NAMES:
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.08, 3)).as_matrix()
        pose[:3, 3] = rng.uniform(-1, 1, 3)
        pictures.append(PosedPicture(name, LENS, pose))
    xyz = rng.uniform([-2, -1.5, 5], [2, 1.5, 9], (80, 3))
    found = {p.name: project_points(xyz, p) + rng.normal(0, 0.3, (80, 2)) for p in pictures}
    same = np.column_stack([np.arange(80)] * 2)
    pairs = tuple(FeatureMatches(a, b, same) for a, b in combinations(NAMES, 2))
    return SparseModel(tuple(pictures), SparsePoints.none(), 0.0), OwnMatches(pairs, found)


def with_turned(model: SparseModel, degrees: float) -> SparseModel:
    pictures = (turned(p, degrees) if p.name == TURNED else p for p in model.pictures)
    return replace(model, pictures=tuple(pictures))


def test_right_cameras_fit_all_their_matches(right: tuple[SparseModel, OwnMatches]) -> None:
    model, own = right
    found = agreements(model, own.pairs, own.found)
    assert [a.matches for a in found.values()] == [80] * 2 + [400] * 6
    assert min(a.share for a in found.values()) > 0.99


def test_a_turned_camera_fits_few_and_the_others_most(
    right: tuple[SparseModel, OwnMatches],
) -> None:
    model, own = right
    shares = own.shares(with_turned(model, 8))
    assert shares.pop(TURNED) < 0.3
    assert min(shares.values()) > 0.75  # four of five pairs of each are right
    assert min(shares[name] for name in NAMES[:2]) > 0.99  # the other capture is not asked


def test_a_slight_turn_lowers_the_share_less(right: tuple[SparseModel, OwnMatches]) -> None:
    model, own = right
    found = [own.shares(with_turned(model, degrees))[TURNED] for degrees in (0, 0.5, 2, 8)]
    assert found == sorted(found, reverse=True)
    assert len(set(found)) == 4


def test_sampsons_distance_by_hand() -> None:
    """Cameras side by side: matches lie on one row, and each end makes up half of what misses."""
    lens = Lens(320, 240, np.array([[400.0, 0, 160], [0, 400, 120], [0, 0, 1]]), np.zeros(4))
    side = np.eye(4)
    side[0, 3] = -1
    ends = PosedPicture("a", lens, np.eye(4)), PosedPicture("b", lens, side)
    first = np.array([[0.1, 0.2], [0.1, 0.2], [-0.3, 0.0]])
    second = first + np.array([[-0.2, 0], [-0.2, 3 / 400], [0.4, -8 / 400]])
    expected = np.array([0, 3, 8]) / np.sqrt(2) / 320
    np.testing.assert_allclose(misses(*ends, first, second), expected, atol=1e-12)


def test_few_matches_say_nothing(right: tuple[SparseModel, OwnMatches]) -> None:
    model, own = right
    few = replace(own.pairs[-1], features=own.pairs[-1].features[: MIN_MATCHES - 1])
    none = replace(own.pairs[-2], features=own.pairs[-2].features[:0])
    assert replace(own, pairs=(few, none)).shares(model) == {}
    enough = replace(few, features=own.pairs[-1].features[:MIN_MATCHES])
    assert set(replace(own, pairs=(enough,)).shares(model)) == {few.first, few.second}


def test_pairs_weigh_by_all_their_matches(
    right: tuple[SparseModel, OwnMatches], monkeypatch: pytest.MonkeyPatch
) -> None:
    """However few of them are looked at."""
    model, own = right
    monkeypatch.setattr("scenediff_classic.geometry.registration.agreement.LOOKED_AT", 10)
    found = agreements(model, own.pairs, own.found)
    assert [a.matches for a in found.values()] == [80] * 2 + [400] * 6


def test_pictures_without_a_camera_are_passed_over(right: tuple[SparseModel, OwnMatches]) -> None:
    model, own = right
    fewer = replace(model, pictures=model.pictures[:-1])
    assert set(own.shares(fewer)) == set(NAMES[:-1])


def test_the_ladder_goes_on_where_a_camera_stands_against_its_matches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first rung is made to turn a camera, without a word of it in the points' errors."""
    whole = Database.reconstruct

    def bent(
        self: Database, folder: Path, recipe: MapperRecipe, seen: Callable, names: Sequence = ()
    ) -> tuple[Path, ...]:
        (found,) = whole(self, folder, recipe, seen, names)
        if names or recipe.name != "incremental":
            return (found,)
        return (write_grown(with_turned(read_model(found), 8), folder / "bent", self),)

    monkeypatch.setattr(Database, "reconstruct", bent)
    captures = capture("before", sweep(4)), capture("after", sweep(2, y=-0.3, z=0.4))
    geometry = StructureFromMotion(long_side=160, attempts=3)(*captures, tmp_path)
    first, second = (line for line in geometry.log if " mapping: " in line)
    assert "before 4 of 4, after 2 of 2 frames registered" in first
    assert "1 of them against their matches" in first
    assert "against" not in second  # and it is good enough to stop
    shares = [view.placement.agreement for view in geometry.views if view.placement]
    assert len(shares) == 6
    assert min(share for share in shares if share is not None) > 0.9


@pytest.mark.parametrize("guided", [False, True])
def test_matches_that_guidance_added_are_not_asked(guided: bool, tmp_path: Path) -> None:
    files = SfmWorkspace(tmp_path)
    files.restart("")
    frames = [*capture("before", sweep(2)).frames, *capture("after", sweep(1)).frames]
    recipe = replace(STANDARD, guided=guided)
    database = matched(write_pictures(frames, files), recipe, files, 0, silent)
    (within,) = (m for m in feature_matches(database) if m.first[0] == m.second[0])
    (own,) = own_matches(database).pairs
    assert (own.first, own.second) == (within.first, within.second)
    rows, kept = ({tuple(row) for row in m.features.tolist()} for m in (within, own))
    assert kept <= rows
    assert len(kept) > 30
    assert (len(kept) < len(rows)) == guided
