"""The fused point cloud and its PLY file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import open3d
import pytest

from scenediff_classic.errors import OutputError
from scenediff_classic.geometry.fusion import ColouredCloud, fuse, write_ply
from scenediff_classic.types import Geometry, SparsePoints
from tests.geometry.textured_room import BOXES, room


def measured_room() -> Geometry:
    """The test room with its true depth as if measured."""
    geometry, truth = room(height=24, width=32, count=2)
    views = tuple(
        replace(v, depth=d, measured=np.ones(v.shape, bool))
        for v, d in zip(geometry.views, truth, strict=True)
    )
    return replace(geometry, views=views)


def test_points_lie_on_the_surface() -> None:
    cloud = fuse(measured_room(), voxel=1e-6)  # nothing merges
    assert len(cloud.xyz) == 2 * 24 * 32
    faces = np.abs(cloud.xyz[:, None, None, :] - BOXES).min(axis=(1, 2, 3))
    assert faces.max() < 1e-4


def test_voxels_merge_points_and_average_colours() -> None:
    view = room(height=24, width=32, count=1)[0].views[0]
    depth = np.full(view.shape, np.nan, np.float32)
    depth[10, 10:12] = 2.0
    image = view.image.copy()
    image[10, 10], image[10, 11] = (10, 20, 30), (30, 20, 11)
    view = replace(view, image=image, depth=depth, measured=np.isfinite(depth))
    cloud = fuse(Geometry((view,), SparsePoints.none()), voxel=100.0)
    assert cloud.xyz.shape == (1, 3)
    assert cloud.rgb.tolist() == [[20, 20, 20]]  # 20.5 rounds to even


def test_completed_depth_is_left_out() -> None:
    geometry = measured_room()
    guessed = tuple(replace(v, measured=np.zeros(v.shape, bool)) for v in geometry.views)
    assert len(fuse(replace(geometry, views=guessed)).xyz) == 0
    assert len(fuse(Geometry((), SparsePoints.none())).xyz) == 0


def test_default_voxel_follows_the_scale_of_the_world() -> None:
    geometry = measured_room()
    geometry = replace(geometry, views=geometry.views * 2)  # every point twice: half must merge
    large = []
    for view in geometry.views:
        pose = view.cam_from_world.copy()
        pose[:3, 3] *= 10
        large.append(replace(view, depth=view.depth * np.float32(10), cam_from_world=pose))
    small, big = fuse(geometry), fuse(replace(geometry, views=tuple(large)))
    assert len(small.xyz) <= 2 * 24 * 32
    assert abs(len(small.xyz) - len(big.xyz)) <= 0.02 * len(small.xyz)  # rounding at cell borders


def test_ply_is_read_back_by_another_program(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cloud = ColouredCloud(
        rng.normal(size=(50, 3)).astype(np.float32),
        rng.integers(0, 256, (50, 3)).astype(np.uint8),
    )
    path = tmp_path / "deeper" / "points.ply"
    write_ply(path, cloud)
    read = open3d.io.read_point_cloud(str(path))
    np.testing.assert_allclose(np.asarray(read.points), cloud.xyz, rtol=1e-6)
    np.testing.assert_allclose(np.asarray(read.colors) * 255, cloud.rgb, atol=1e-6)
    assert [p.name for p in path.parent.iterdir()] == ["points.ply"]


def test_ply_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    empty = ColouredCloud(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))
    with pytest.raises(OutputError, match=r"points\.ply"):
        write_ply(tmp_path / "file" / "points.ply", empty)
