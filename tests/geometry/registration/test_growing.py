"""Pieces and left-out pictures of a drawn room, with COLMAP's own matches and models."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from scenediff_classic.cameras import camera_centre
from scenediff_classic.geometry.registration import leftovers
from scenediff_classic.geometry.registration.colmap.database import Database
from scenediff_classic.geometry.registration.colmap.growing import write_grown
from scenediff_classic.geometry.registration.colmap.models import read_model
from scenediff_classic.geometry.registration.ladder import INCREMENTAL, STANDARD
from scenediff_classic.geometry.registration.leftovers import place_leftovers
from scenediff_classic.geometry.registration.matching import matched
from scenediff_classic.geometry.registration.merging import merge
from scenediff_classic.geometry.registration.sfm_workspace import SfmWorkspace, write_pictures
from scenediff_classic.geometry.registration.sparse_model import MapperRecipe
from scenediff_classic.geometry.registration.structure_from_motion import StructureFromMotion
from scenediff_classic.protocols import silent
from tests.geometry.cards import capture, similarity_residual, sweep

POSES = {"before": sweep(4), "after": sweep(4, y=-0.3, z=0.4)}
TRUTH = {f"{v}/{i:05d}.png": pose for v, poses in POSES.items() for i, pose in enumerate(poses)}
BEFORE, AFTER = sorted(TRUTH)[4:], sorted(TRUTH)[:4]
FOREIGN = "after/00004.png"


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Database:
    """Of both captures, and a picture of another room where a poster shows a part of this one."""
    files = SfmWorkspace(tmp_path_factory.mktemp("database"))
    files.restart("")
    frames = [*capture("before", POSES["before"]).frames, *capture("after", POSES["after"]).frames]
    stranger = capture("after", sweep(5), seed=7).frames[4]
    stranger.image[60:150, 80:200] = frames[-2].image[80:170, 100:220]
    pictures = write_pictures([*frames, stranger], files)
    return matched(pictures, STANDARD, files, 0, silent)


def mapped(database: Database, folder: Path, names: Sequence[str]) -> Path:
    (model,) = database.reconstruct(folder, INCREMENTAL, lambda n: None, names)
    return model


def assert_right(folder: Path, names: Sequence[str]) -> None:
    model = read_model(folder)
    assert [picture.name for picture in model.pictures] == sorted(names)
    found = np.array([camera_centre(p.cam_from_world) for p in model.pictures])
    true = np.array([camera_centre(TRUTH[p.name]) for p in model.pictures])
    assert similarity_residual(found, true) < 0.01


def test_a_model_goes_back_into_the_databases_terms(database: Database, tmp_path: Path) -> None:
    model = read_model(mapped(database, tmp_path / "own", BEFORE))
    again = read_model(write_grown(model, tmp_path / "again", database))
    assert again.features is not None
    np.testing.assert_array_equal(again.features, model.features)
    np.testing.assert_array_equal(again.keypoints, model.keypoints)
    np.testing.assert_array_equal(again.points.observations, model.points.observations)
    np.testing.assert_array_equal(again.points.xyz, model.points.xyz)
    for one, other in zip(model.pictures, again.pictures, strict=True):
        np.testing.assert_allclose(other.cam_from_world, one.cam_from_world, atol=1e-12)
        np.testing.assert_array_equal(other.lens.intrinsics, one.lens.intrinsics)


@pytest.mark.parametrize(
    "pieces",
    [
        (BEFORE, AFTER),
        ([*BEFORE[:2], *AFTER[:2]], [*BEFORE[2:], *AFTER[2:]]),
        ([*BEFORE, AFTER[0]], AFTER),  # a picture in both
    ],
)
def test_pieces_become_one_model(
    pieces: tuple[list[str], list[str]], database: Database, tmp_path: Path
) -> None:
    models = [mapped(database, tmp_path / str(n), names) for n, names in enumerate(pieces)]
    (joint,) = merge(models, database, tmp_path / "merged")
    assert_right(joint, [*BEFORE, *AFTER])


def test_three_pieces_become_one_model(database: Database, tmp_path: Path) -> None:
    pieces = (BEFORE[:3], [BEFORE[3], *AFTER[:2]], AFTER[1:])
    models = [mapped(database, tmp_path / str(n), names) for n, names in enumerate(pieces)]
    (joint,) = merge(models, database, tmp_path / "merged")
    assert_right(joint, [*BEFORE, *AFTER])


def test_a_left_out_picture_finds_its_place_and_a_strangers_does_not(
    database: Database, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    missing = (AFTER[1], BEFORE[2])
    names = [name for name in [*BEFORE, *AFTER] if name not in missing]
    model = mapped(database, tmp_path / "part", names)
    folder, placed = place_leftovers(model, database, tmp_path / "left", lens=True)
    assert placed == missing
    assert_right(folder, [*BEFORE, *AFTER])
    grown = read_model(folder)
    seen = np.bincount(grown.points.observations[:, 1])
    assert seen.min() > 50
    monkeypatch.setattr(leftovers, "MIN_COVER", 0.0)  # what keeps the poster out
    _, placed = place_leftovers(model, database, tmp_path / "careless", lens=True)
    assert FOREIGN in placed


def test_a_whole_capture_with_its_own_camera_finds_its_place(
    database: Database, tmp_path: Path
) -> None:
    """The lens of after is not known from the model: mapping's first guess is refined."""
    model = mapped(database, tmp_path / "part", BEFORE)
    folder, placed = place_leftovers(model, database, tmp_path / "left", lens=True)
    assert placed == tuple(AFTER)
    assert_right(folder, [*BEFORE, *AFTER])


def test_a_model_that_lacks_nothing_stays(database: Database, tmp_path: Path) -> None:
    model = mapped(database, tmp_path / "all", [*BEFORE, *AFTER])
    folder, placed = place_leftovers(model, database, tmp_path / "left", lens=True)
    assert (folder, placed) == (model, ())  # a stranger's picture is no left-out one


def test_registration_joins_models_and_places_what_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mapper is made to give up between the captures, and on one picture."""
    whole = Database.reconstruct

    def broken(
        self: Database, folder: Path, recipe: MapperRecipe, seen: Callable, names: Sequence = ()
    ) -> tuple[Path, ...]:
        if names:
            return whole(self, folder, recipe, seen, names)
        pieces = enumerate((BEFORE, [AFTER[0], *AFTER[2:]]))
        return tuple(whole(self, folder / f"{n}", recipe, seen, p)[0] for n, p in pieces)

    monkeypatch.setattr(Database, "reconstruct", broken)
    captures = capture("before", POSES["before"]), capture("after", POSES["after"])
    geometry = StructureFromMotion(long_side=160, attempts=1)(*captures, tmp_path)
    assert sum("joined by the matches" in line for line in geometry.log) == 1
    assert sum("Placed 1 left-out frame against" in line for line in geometry.log) == 1
    assert not geometry.unregistered
    found = np.array([camera_centre(view.cam_from_world) for view in geometry.views])
    true = np.array([camera_centre(POSES[view.video][view.index]) for view in geometry.views])
    assert similarity_residual(found, true) < 0.01
    for view in geometry.views:
        assert view.placement is not None
        assert view.placement.confidence > 0.5
