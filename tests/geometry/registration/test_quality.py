"""Judging reconstructions by numbers that can be worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.geometry.registration.quality import (
    MIN_AGREEMENT,
    Quality,
    failure,
    frame_reason,
    has_parallax,
    has_support,
    judge,
    ray_angle,
    usable_frames,
    weak_pictures,
)
from scenediff_classic.geometry.registration.sparse_model import (
    PairMatch,
    PosedPicture,
    SparseModel,
)
from scenediff_classic.types import Lens, SparsePoints

GOOD = Quality(
    registered={"before": 5, "after": 5},
    total={"before": 5, "after": 5},
    points=500,
    bridge=200,
    overlap=0.7,
    error=0.5,
    angle=15.0,
    sane=True,
)


THREE = np.array([[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 0], [2, 1]])
"""Point 0 is seen by all cameras, 1 by the right two, 2 by the left two."""
FILLER = 12
"""Points seen by all three cameras, so that their cameras are more than guesses."""


def camera_at(x: float, focal: float, name: str) -> PosedPicture:
    pose = np.eye(4)
    pose[0, 3] = -x
    intrinsics = np.array([[focal, 0, 50], [0, focal, 40], [0, 0, 1]])
    return PosedPicture(name, Lens(100, 80, intrinsics, np.zeros(4)), pose)


def model(focal: float = 120.0, error: float = 0.5) -> SparseModel:
    """Three cameras in a row at x = -1, 0, 1; points straight ahead at z = 1."""
    pictures = (
        camera_at(-1, focal, "after/00000.png"),
        camera_at(0, focal, "before/00000.png"),
        camera_at(1, focal, "before/00001.png"),
    )
    filler = [[3 + n, camera] for n in range(FILLER) for camera in range(3)]
    observations = np.concatenate([THREE, filler])
    count = 3 + FILLER
    xyz = np.array([[0.0, 0, 1]] * count)
    points = SparsePoints(xyz, np.zeros((count, 3), np.uint8), observations)
    return SparseModel(pictures, points, error)


def test_ray_angle_by_hand() -> None:
    """From (0, 0, 1), cameras 1 to the left and right are 90 degrees apart, others 45."""
    centres = [np.array([x, 0.0, 0.0]) for x in (-1, 0, 1)]
    three = SparsePoints(np.array([[0.0, 0, 1]] * 3), np.zeros((3, 3), np.uint8), THREE)
    assert ray_angle(centres, three) == pytest.approx(45)
    only_first = SparsePoints(np.array([[0.0, 0, 1]]), np.zeros((1, 3), np.uint8),
                              np.array([[0, 2], [0, 0], [0, 1]]))  # fmt: skip
    assert ray_angle(centres, only_first) == pytest.approx(90)
    assert ray_angle(centres, SparsePoints.none()) == 0


def test_judge_counts_frames_and_bridging_points() -> None:
    quality = judge(model(), {"before": 2, "after": 2})
    assert quality.registered == {"before": 2, "after": 1}
    assert (quality.points, quality.bridge) == (3 + FILLER, 2 + FILLER)
    assert quality.sane
    assert "before 2 of 2, after 1 of 2" in str(quality)


def test_overlap_is_that_of_the_best_frame_in_the_poorer_capture() -> None:
    """Twelve points bridge; 28 more are the after camera's own, 8 more the second before's."""
    lone = [[3 + FILLER + n, 0] for n in range(28)] + [[43 + n, 2] for n in range(8)]
    filler = [[3 + n, camera] for n in range(FILLER) for camera in (0, 2)]
    full = model()
    points = SparsePoints(
        np.array([[0.0, 0, 1]] * 51), np.zeros((51, 3), np.uint8), np.array(filler + lone)
    )
    quality = judge(replace(full, points=points), {"before": 2, "after": 1})
    assert quality.bridge == FILLER
    assert quality.overlap == pytest.approx(12 / 40)  # before: 12 / 20
    alone = replace(points, observations=np.array(lone))
    assert judge(replace(full, points=alone), {"before": 2, "after": 1}).overlap == 0


@pytest.mark.parametrize(("focal", "error"), [(10.0, 0.5), (900.0, 0.5), (120.0, 5.0)])
def test_odd_lens_or_large_error_is_not_sane(focal: float, error: float) -> None:
    assert not judge(model(focal, error), {"before": 2, "after": 1}).sane


def test_what_counts_as_aligned_and_complete() -> None:
    assert GOOD.aligned
    assert GOOD.complete
    for change in (
        {"sane": False}, {"angle": 0.5}, {"bridge": 5}, {"overlap": 0.04},
        {"registered": {"before": 5, "after": 0}},
    ):  # fmt: skip
        assert not replace(GOOD, **change).aligned
    for change in ({"bridge": 20}, {"registered": {"before": 5, "after": 4}}):
        weaker = replace(GOOD, **change)
        assert weaker.aligned
        assert not weaker.complete
        assert weaker.rank < GOOD.rank
    assert replace(GOOD, sane=False).rank < replace(GOOD, bridge=20).rank


def test_a_camera_that_rests_on_few_points_does_not_count() -> None:
    full = model()
    fewer = replace(full.points, observations=full.points.observations[:-18])
    sparse = replace(full, points=fewer)
    assert weak_pictures(sparse) == {"after/00000.png": 8, "before/00000.png": 9,
                                     "before/00001.png": 8}  # fmt: skip
    assert judge(sparse, {"before": 2, "after": 1}).registered == {"before": 0, "after": 0}
    assert weak_pictures(full) == {}


def test_a_camera_against_its_matches_counts_for_less() -> None:
    shares = {"before/00000.png": MIN_AGREEMENT - 0.01, "before/00001.png": MIN_AGREEMENT}
    quality = judge(model(), {"before": 2, "after": 1}, shares)
    assert quality.registered == {"before": 2, "after": 1}
    assert quality.opposed == {"before": 1, "after": 0}
    assert "1 of them against their matches" in str(quality)
    assert "against" not in str(judge(model(), {"before": 2, "after": 1}))
    opposed = replace(GOOD, opposed={"before": 0, "after": 1})
    assert opposed.aligned
    assert not opposed.complete
    lacking = replace(GOOD, registered={"before": 5, "after": 4})
    assert replace(GOOD, sane=False).rank < opposed.rank < lacking.rank < GOOD.rank
    many = dict.fromkeys(GOOD.total, 20)
    few_of_many = replace(opposed, registered=many, total=many)
    assert few_of_many.complete  # one of twenty is left to the warning


def test_a_guess_of_a_camera_is_not_counted_twice() -> None:
    """It is not registered: its disagreement takes nothing away from the others."""
    full = model()
    sparse = replace(full, points=replace(full.points, observations=full.points.observations[:-18]))
    quality = judge(sparse, {"before": 2, "after": 1}, {"before/00000.png": 0.0})
    assert quality.opposed == {"before": 0, "after": 0}


def test_frames_without_features_do_not_count() -> None:
    features = {"before/00000.png": 900, "before/00001.png": 3, "after/00000.png": 0}
    assert usable_frames(features) == {"before": 1, "after": 1}


def pair(first: str, second: str, **change: float) -> PairMatch:
    plain = PairMatch(f"{first}.png", f"{second}.png", 100, 0.1, 0.02)
    return replace(plain, **change)


FEATURES = {f"{video}/{i}.png": 900 for video in ("before", "after") for i in range(3)}
LINKED = [pair("before/0", "after/0")]


@pytest.mark.parametrize(
    ("qualities", "features", "pairs", "reason"),
    [
        ([], FEATURES | {f"after/{i}.png": 7 for i in range(3)}, LINKED, "no frame of after has"),
        ([], FEATURES, [pair("before/0", "before/1")], "anything that is also recognised"),
        ([], FEATURES, [pair("before/0", "after/0", shift=0.001)], "does not move"),
        ([], FEATURES, [pair("before/0", "after/0", parallax=0.001)], "only turns on the spot"),
        (
            [replace(GOOD, registered={"before": 5, "after": 0}),
             replace(GOOD, registered={"before": 0, "after": 4})],
            FEATURES, LINKED, "each was reconstructed on its own",
        ),
        ([], FEATURES, LINKED, "too few matches agree"),
    ],
)  # fmt: skip
def test_failure_names_the_cause(
    qualities: list[Quality], features: dict[str, int], pairs: list[PairMatch], reason: str
) -> None:
    sentence = failure(qualities, features, pairs)
    assert reason in sentence
    assert sentence.endswith(".")


def test_parallax_is_the_departure_from_a_homography() -> None:
    """A turning camera maps by a homography; a tenth and more of points before it do not."""
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 1, (200, 2))
    turned = xy @ np.array([[1.02, 0.05], [-0.03, 0.98]]) + [0.1, 0.02]
    plain = PairMatch.measure("a", "b", xy, turned)
    assert plain.parallax < 1e-6
    assert plain.shift == pytest.approx(np.median(np.linalg.norm(turned - xy, axis=1)))
    turned[:40, 0] += 0.05
    assert PairMatch.measure("a", "b", xy, turned).parallax == pytest.approx(0.05, rel=0.05)
    assert PairMatch.measure("a", "b", xy[:3], turned[:3]).parallax == 0


def test_few_matches_prove_no_parallax() -> None:
    assert has_parallax(LINKED)
    assert not has_parallax([pair("before/0", "after/0", inliers=20)])


def test_reasons_for_a_missing_frame() -> None:
    assert "only 7 features" in frame_reason("a.png", {"a.png": 7}, [], {})
    assert "nothing in it matches" in frame_reason("a.png", {"a.png": 700}, LINKED, {})
    assert "do not agree" in frame_reason("a.png", {"a.png": 700}, [pair("a", "b")], {})
    assert "only 4 points" in frame_reason("a.png", {"a.png": 700}, [pair("a", "b")], {"a.png": 4})


def test_only_matches_across_captures_are_support() -> None:
    within = PairMatch("before/0", "before/1", 400, 0.1, 0.02)
    weak = PairMatch("before/0", "after/1", 17, 0.1, 0.02)
    strong = PairMatch("before/0", "after/1", 121, 0.1, 0.02)
    assert not has_support([within, weak])
    assert has_support([within, weak, strong])
