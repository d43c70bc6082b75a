"""Models laid over each other by matches: found where they agree, refused where they do not."""

import numpy as np

from scenediff_classic.geometry.registration.joining import join
from scenediff_classic.geometry.registration.merging import matched_points, seam, tie
from scenediff_classic.geometry.registration.sparse_model import FeatureMatches, SparseModel
from tests.geometry.registration.test_alignments import MOVE, WORLD, scene


def matches(first: SparseModel, second: SparseModel, features: np.ndarray) -> list[FeatureMatches]:
    """The same matches between every two pictures; in these models, features count points."""
    return [
        FeatureMatches(b.name, a.name, features[:, ::-1])
        for a in first.pictures
        for b in second.pictures
    ]


def same(count: int) -> np.ndarray:
    return np.stack([np.arange(count)] * 2, axis=1)


def test_matches_tell_the_motion_and_the_points() -> None:
    before, after, *_ = scene(0)
    found = tie(before, after, matches(before, after, same(150)))
    assert found.firm
    np.testing.assert_allclose(found.motion, WORLD, atol=1e-6)
    np.testing.assert_array_equal(found.pairs, same(150))
    assert (found.tried, found.second) == (150, 0)


def test_wrong_matches_are_outvoted() -> None:
    before, after, *_ = scene(0)
    features = same(150)
    features[90:, 1] = np.random.default_rng(0).permutation(features[90:, 1])
    found = tie(before, after, matches(before, after, features))
    assert found.firm
    np.testing.assert_allclose(found.motion, WORLD, atol=1e-6)
    assert 90 <= len(found.pairs) <= 95


def test_matches_by_chance_join_nothing() -> None:
    before, after, *_ = scene(0)
    features = same(150)
    features[:, 1] = np.random.default_rng(0).permutation(150)
    assert not tie(before, after, matches(before, after, features)).firm
    assert not tie(before, after, []).firm


def test_two_motions_that_are_as_likely_join_nothing() -> None:
    """As with repeated things: half of the matches speak for one place, half for another."""
    before, after, *_ = scene(moved=150)
    found = tie(before, after, matches(before, after, same(300)))
    assert min(len(found.pairs), found.second) >= 148
    assert not found.firm
    fewer = tie(before, after, matches(before, after, same(200)))  # 50 of what moved
    assert fewer.firm
    np.testing.assert_allclose(fewer.motion, WORLD, atol=1e-6)
    assert not np.allclose(fewer.motion, MOVE @ WORLD, atol=1e-2)


def test_each_point_is_in_one_pair_the_one_with_most_votes() -> None:
    before, after, *_ = scene(0)
    often = matches(before, after, np.array([[0, 0], [1, 1]]))
    once = FeatureMatches(before.pictures[0].name, after.pictures[0].name, np.array([[0, 1]]))
    pairs = matched_points(before, after, [once, *often])
    np.testing.assert_array_equal(pairs, [[0, 0], [1, 1]])


def test_a_picture_in_both_models_ties_them() -> None:
    before, _, *_ = scene(0)
    np.testing.assert_array_equal(matched_points(before, before, []), same(150))


def test_a_picture_in_both_models_keeps_its_place_in_the_target() -> None:
    before, *_ = scene(0)
    elsewhere = np.diag([2.0, 2.0, 2.0, 1.0])
    joint = join(before, before, elsewhere, same(150)[:100])
    assert [p.name for p in joint.pictures] == [p.name for p in before.pictures]
    for one, other in zip(joint.pictures, before.pictures, strict=True):
        np.testing.assert_array_equal(one.cam_from_world, other.cam_from_world)
    assert len(joint.points.xyz) == 150  # what only the moved pictures saw is gone


def test_a_seam_counts_points_that_both_sides_see_where_they_are() -> None:
    before, after, *_ = scene(0)
    groups = [{p.name for p in model.pictures} for model in (before, after)]
    assert seam(join(before, after, WORLD, same(150)[:40]), *groups) == 40
    off = WORLD.copy()
    off[0, 3] += 1.0
    assert seam(join(before, after, off, same(150)[:40]), *groups) == 0
