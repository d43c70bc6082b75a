"""Placing a picture by points: what is found, and what must not pass for a camera."""

import numpy as np
import pytest

from scenediff_classic.cameras import camera_centre, project
from scenediff_classic.geometry.registration.leftovers import (
    Sighting,
    offers,
    sight,
    with_sightings,
)
from scenediff_classic.geometry.registration.sparse_model import FeatureMatches, residuals
from scenediff_classic.types import Lens
from tests.geometry.cards import FOCAL, INTRINSICS, look
from tests.geometry.registration.test_alignments import scene

LENS = Lens(320, 240, INTRINSICS, np.zeros(4))
POSE, ANOTHER = look((0.4, -0.2, 0.1), -0.2), look((-0.7, 0.1, 0.3), 0.25)


def cloud(count: int, low: tuple[float, float] = (-1.2, -0.9)) -> np.ndarray:
    """Points before all cameras; `low` = where the cloud begins (x, y)."""
    return np.random.default_rng(0).uniform([*low, 3], [1.2, 0.9, 5], (count, 3))


def seen_at(pose: np.ndarray, xyz: np.ndarray, noise: float = 0.4) -> np.ndarray:
    xy = project(xyz, INTRINSICS, pose)[0]
    return xy + np.random.default_rng(1).normal(0, noise, xy.shape)


def tell(xy: np.ndarray, xyz: np.ndarray, **options: bool) -> Sighting | None:
    offered = np.stack([np.arange(len(xyz))] * 2, axis=1)
    return sight("after/00000.png", LENS, offered, xy, xyz, **options)


def test_the_camera_is_found_among_wrong_offers() -> None:
    xyz = cloud(100)
    xy = seen_at(POSE, xyz)
    xy[70:] = np.random.default_rng(2).uniform([0, 0], [320, 240], (30, 2))
    found = tell(xy, xyz)
    assert found is not None
    assert found.firm
    assert set(range(70)) <= set(found.seen[:, 1].tolist()) <= set(range(100))
    assert len(found.seen) < 75
    np.testing.assert_allclose(
        camera_centre(found.picture.cam_from_world), camera_centre(POSE), atol=0.01
    )
    np.testing.assert_allclose(found.picture.cam_from_world[:3, :3], POSE[:3, :3], atol=0.003)


def test_a_lens_that_is_a_guess_is_refined() -> None:
    xyz = cloud(200)
    guess = Lens(320, 240, INTRINSICS * [[1.1], [1.1], [1]], np.zeros(4))
    guess.intrinsics[:2, 2] = INTRINSICS[:2, 2]
    offered = np.stack([np.arange(200)] * 2, axis=1)
    found = sight("a", guess, offered, seen_at(POSE, xyz, 0.1), xyz, refine_lens=True)
    assert found is not None
    assert found.firm
    assert found.picture.lens.intrinsics[0, 0] == pytest.approx(FOCAL, rel=0.01)


def test_chance_is_no_camera() -> None:
    xyz = cloud(140)
    found = tell(np.random.default_rng(2).uniform([0, 0], [320, 240], (140, 2)), xyz)
    assert found is None or not found.firm


def test_two_cameras_that_are_as_likely_are_none() -> None:
    """A repeated thing: half of the offers say here, half say there."""
    xyz = cloud(100)
    xy = seen_at(POSE, xyz)
    xy[50:] = seen_at(ANOTHER, xyz)[50:]
    found = tell(xy, xyz)
    assert found is not None
    assert min(len(found.seen), found.second) >= 48
    assert not found.firm
    xy[55:] = seen_at(POSE, xyz)[55:]
    clear = tell(xy, xyz)
    assert clear is not None
    assert clear.firm


def test_points_in_a_corner_are_not_enough() -> None:
    """As of a single thing that moved, or a print of which there are two."""
    corner = cloud(100, low=(0.7, 0.5))
    found = tell(seen_at(POSE, corner), corner)
    assert found is None or not found.firm


@pytest.mark.parametrize(("count", "firm"), [(19, False), (30, True)])
def test_a_few_points_are_not_enough(count: int, firm: bool) -> None:
    xyz = cloud(count)
    found = tell(seen_at(POSE, xyz), xyz)
    assert (found is not None and found.firm) == firm


def test_offers_are_what_most_matches_say() -> None:
    points = {"b": {0: 10, 1: 11}, "c": {5: 10}}
    matches = [
        FeatureMatches("a", "b", np.array([[3, 0], [4, 1], [7, 9]])),
        FeatureMatches("c", "a", np.array([[5, 4]])),
        FeatureMatches("a", "d", np.array([[8, 0]])),
        FeatureMatches("b", "c", np.array([[0, 5]])),
    ]
    np.testing.assert_array_equal(offers("a", points, matches), [[3, 10], [4, 10]])
    twice = [*matches, FeatureMatches("a", "b", np.array([[4, 1]]))]
    np.testing.assert_array_equal(offers("a", points, twice), [[3, 10], [4, 11]])
    assert len(offers("a", {"e": {0: 1}}, matches)) == 0


def test_a_placed_picture_sees_its_points_where_they_were_found() -> None:
    before, *_ = scene(0)
    removed = before.pictures[1]
    found = {removed.name: np.zeros((200, 2))}
    seen = np.stack([np.arange(30) + 100, np.arange(30)], axis=1)
    xy, _ = project(before.points.xyz[:30], INTRINSICS, removed.cam_from_world)
    found[removed.name][100:130] = xy
    late = Sighting(removed, seen, 30, 1.0, 0)
    held = before.points.observations[:, 1] != 1
    assert before.keypoints is not None
    assert before.features is not None
    observations = before.points.observations[held]
    observations[:, 1] -= observations[:, 1] > 1
    model = type(before)(
        (before.pictures[0], *before.pictures[2:]),
        type(before.points)(before.points.xyz, before.points.rgb, observations),
        before.error,
        before.keypoints[held],
        before.features[held],
    )
    grown = with_sightings(model, [late], found)
    assert [p.name for p in grown.pictures] == [p.name for p in before.pictures]
    assert len(grown.points.observations) == held.sum() + 30
    assert np.nanmax(np.abs(residuals(grown))) < 1e-3
    assert grown.features is not None
    point, picture = grown.points.observations.T
    np.testing.assert_array_equal(grown.features[picture == 1], point[picture == 1] + 100)
