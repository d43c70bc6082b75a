"""How firmly frames are placed, worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from scenediff_classic.geometry.registration.placement import placements
from scenediff_classic.geometry.registration.quality import MAX_ERROR
from scenediff_classic.geometry.registration.sparse_model import SparseModel, project_points
from tests.geometry.registration.test_quality import FILLER, model


def exact_model() -> SparseModel:
    """Every point was found where it projects to."""
    full = model()
    xy = [project_points(full.points.xyz[[p]], full.pictures[k]) for p, k in
          full.points.observations]  # fmt: skip
    return replace(full, keypoints=np.concatenate(xy))


def test_placements_by_hand() -> None:
    """The after camera sees 14 points; 13 of them, the first but one included, bridge."""
    full = exact_model()
    after, first, second = placements(full)
    assert (after.points, after.shared) == (2 + FILLER, 2 + FILLER)
    assert (first.points, first.shared) == (3 + FILLER, 2 + FILLER)
    assert (second.points, second.shared) == (2 + FILLER, 1 + FILLER)
    assert first.cover == 1 / 16  # all points lie in one spot
    assert first.error_px == 0
    assert first.confidence == pytest.approx(15 / 65 * 14 / 26 * 0.125)
    assert second.confidence < first.confidence


def test_a_larger_error_lowers_the_confidence() -> None:
    exact = exact_model()
    assert exact.keypoints is not None
    off = replace(exact, keypoints=exact.keypoints + np.array([MAX_ERROR, 0]))
    for one, other in zip(placements(exact), placements(off), strict=True):
        assert other.error_px == pytest.approx(MAX_ERROR)
        assert other.confidence == pytest.approx(one.confidence / 2)


def test_little_agreement_lowers_the_confidence() -> None:
    exact = exact_model()
    names = [picture.name for picture in exact.pictures]
    plain, asked = placements(exact), placements(exact, {names[1]: 0.25, names[2]: 0.75})
    assert [p.agreement for p in asked] == [None, 0.25, 0.75]
    assert asked[0] == plain[0]
    for one, other in zip(plain[1:], asked[1:], strict=True):
        assert other.agreement is not None
        assert other.confidence == pytest.approx(one.confidence * other.agreement)


def test_points_behind_a_camera_have_no_error() -> None:
    exact = exact_model()
    exact.points.xyz[-1] *= -1
    assert all(np.isfinite(placement.error_px) for placement in placements(exact))
