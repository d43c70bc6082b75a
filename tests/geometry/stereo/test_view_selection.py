"""Source views, depth range and angle weights."""

from dataclasses import replace

import numpy as np

from scenediff_classic.geometry.stereo.view_selection import (
    angle_weight,
    inverse_depth_range,
    observed_points,
    select_sources,
)
from scenediff_classic.types import Geometry, SparsePoints
from tests.geometry.textured_room import room


def sources(geometry: Geometry, position: int, **options) -> tuple[int, ...]:
    limits = {"count": 5, "enough": 2, "borrowed": 5} | options
    return select_sources(geometry, position, **limits)


def small_room(count: int, **options) -> Geometry:
    return room(height=24, width=32, count=count, **options)[0]


def test_angles_of_five_to_fifteen_degrees_are_best() -> None:
    weight = angle_weight(np.array([0.0, 1.0, 5.0, 10.0, 15.0, 30.0, 45.0, 90.0]))
    assert weight[0] == 0
    assert np.all(weight[2:5] == 1)
    assert weight[1] < 0.05
    assert np.all(np.diff(weight[4:]) < 0)
    assert weight[6] < 0.02


def test_sources_are_of_the_same_video_and_never_the_view_itself() -> None:
    before, after = small_room(4), small_room(3, video="after")
    both = replace(before, views=before.views + after.views)
    for position in range(7):
        chosen = sources(both, position, count=2)
        own = range(4) if position < 4 else range(4, 7)
        assert len(chosen) == 2
        assert set(chosen) <= set(own) - {position}


def test_sparse_capture_borrows_from_the_other() -> None:
    before, after = small_room(4), small_room(2, video="after")
    both = replace(before, views=before.views + after.views)
    assert set(sources(both, 5)) == {0, 1, 2, 3, 4}
    assert sources(both, 5)[0] == 4  # its own view comes first
    assert len(sources(both, 5, borrowed=2)) == 3
    assert set(sources(both, 0)) == {1, 2, 3}  # enough of its own
    assert set(sources(both, 0, enough=4)) == {1, 2, 3, 4, 5}
    assert set(sources(both, 0, enough=4, count=1)) > {4, 5}  # own ones are counted apart


def test_view_that_shares_nothing_is_no_source() -> None:
    geometry = small_room(3)
    turned = geometry.views[2].cam_from_world.copy()
    turned[:3] = np.diag([-1.0, 1.0, -1.0]) @ turned[:3]  # looks the other way
    views = (*geometry.views[:2], replace(geometry.views[2], cam_from_world=turned))
    observations = geometry.points.observations
    points = replace(geometry.points, observations=observations[observations[:, 1] < 2])
    assert sources(replace(geometry, views=views, points=points), 0) == (1,)
    bare = replace(geometry, views=views, points=SparsePoints.none())
    assert sources(bare, 0) == (1,)


def test_camera_at_the_same_place_is_no_source() -> None:
    geometry = small_room(3)
    twin = replace(geometry.views[0], index=3)
    bare = replace(geometry, views=(*geometry.views, twin), points=SparsePoints.none())
    assert set(sources(bare, 0)) == {1, 2}  # no parallax, no use


def test_depth_range_holds_the_points_and_scales_with_the_world() -> None:
    geometry, truth = room(height=24, width=32, count=3)
    view = geometry.views[1]
    points = geometry.points.xyz[observed_points(geometry)[1]]
    low, high = inverse_depth_range(view, points, geometry.views, 1.4)
    assert low < 1 / truth[1].max()
    assert high > 1 / truth[1].min()
    far = view.cam_from_world.copy()
    far[:3, 3] *= 10
    scaled = inverse_depth_range(
        replace(view, cam_from_world=far), points * 10, geometry.views, 1.4
    )
    np.testing.assert_allclose(scaled, (low / 10, high / 10))


def test_depth_range_without_points_follows_from_parallax() -> None:
    geometry = small_room(3)
    view = geometry.views[1]
    low, high = inverse_depth_range(view, np.zeros((0, 3)), (geometry.views[0],), 1.4)
    centres = [np.linalg.inv(v.cam_from_world)[:3, 3] for v in geometry.views[:2]]
    baseline = np.linalg.norm(centres[1] - centres[0])
    np.testing.assert_allclose(low, 1 / (0.85 * 32 * baseline))  # one pixel
    np.testing.assert_allclose(high, 16 * low)  # half the picture
