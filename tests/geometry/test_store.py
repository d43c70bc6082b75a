"""A geometry written to disk comes back the same, and COLMAP can read its model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenediff_classic.errors import InputError, OutputError
from scenediff_classic.geometry.known_cameras import KnownGeometry
from scenediff_classic.geometry.registration.colmap.models import read_model
from scenediff_classic.geometry.store import SavedGeometry, load_geometry, save_geometry
from scenediff_classic.geometry.views import make_view
from scenediff_classic.types import Capture, Geometry, Lens, Placement, SparsePoints, Unregistered
from tests.geometry.cards import FOCAL, HEIGHT, INTRINSICS, WIDTH, capture, files_in, sweep


@pytest.fixture(scope="module")
def captures() -> tuple[Capture, Capture]:
    return capture("before", sweep(2)), capture("after", sweep(2, y=0.1))


@pytest.fixture(scope="module")
def geometry(captures: tuple[Capture, Capture]) -> Geometry:
    lens = Lens(WIDTH, HEIGHT, INTRINSICS, np.array([0.08, 0, 0, 0]))
    depth = np.full((HEIGHT, WIDTH), 3.0, np.float32)
    depth[:40] = np.nan
    frames = (*captures[0].frames, captures[1].frames[0])
    views = [make_view(f, lens, p, 160, depth) for f, p in zip(frames, sweep(3), strict=True)]
    views[0] = replace(views[0], measured=np.zeros_like(views[0].measured))
    views[1] = replace(views[1], placement=Placement(0.4, 30, 12, 0.5, 0.8, 0.9))
    points = SparsePoints(
        np.array([[0.0, 0.2, 3.0]]), np.array([[9, 8, 7]], np.uint8), np.array([[0, 0], [0, 2]])
    )
    missing = Unregistered("after", 1, "nothing in it matches another frame")
    return Geometry(tuple(views), points, (missing,), ("careful",), ("tried",), 0.37, bridge=12)


def assert_same(one: Geometry, other: Geometry) -> None:
    for a, b in zip(one.views, other.views, strict=True):
        assert (a.key, a.name, a.placement) == (b.key, b.name, b.placement)
        for field in (
            "image", "intrinsics", "cam_from_world", "depth", "confidence", "measured", "ignore",
        ):  # fmt: skip
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
            assert getattr(a, field).dtype == getattr(b, field).dtype
        np.testing.assert_array_equal(a.lens.intrinsics, b.lens.intrinsics)
        np.testing.assert_array_equal(a.lens.distortion, b.lens.distortion)
        assert (a.lens.width, a.lens.height) == (b.lens.width, b.lens.height)
    np.testing.assert_array_equal(one.points.xyz, other.points.xyz)
    np.testing.assert_array_equal(one.points.rgb, other.points.rgb)
    np.testing.assert_array_equal(one.points.observations, other.points.observations)
    for field in ("unregistered", "warnings", "log", "unit", "bridge"):
        assert getattr(one, field) == getattr(other, field)


def test_round_trip(geometry: Geometry, captures: tuple[Capture, Capture], tmp_path: Path) -> None:
    save_geometry(geometry, tmp_path / "geometry")
    assert_same(load_geometry(tmp_path / "geometry", *captures), geometry)
    assert_same(KnownGeometry(tmp_path)(*captures, tmp_path), geometry)
    assert_same(SavedGeometry(tmp_path / "geometry")(*captures, tmp_path), geometry)


def test_colmap_model_is_of_the_input_pictures(geometry: Geometry, tmp_path: Path) -> None:
    save_geometry(geometry, tmp_path / "geometry")
    model = read_model(tmp_path / "geometry/sparse")
    assert [p.name for p in model.pictures] == [
        "after/after0.png", "before/before0.png", "before/before1.png",
    ]  # fmt: skip
    for picture in model.pictures:
        assert (picture.lens.width, picture.lens.height) == (WIDTH, HEIGHT)
        assert picture.lens.intrinsics[0, 0] == FOCAL
        assert picture.lens.distortion[0] == 0.08
    assert sorted(model.points.observations.tolist()) == [[0, 0], [0, 1]]


def test_saving_again_replaces_all(geometry: Geometry, tmp_path: Path) -> None:
    save_geometry(geometry, tmp_path / "geometry")
    save_geometry(replace(geometry, views=geometry.views[:1],
                          points=SparsePoints.none()), tmp_path / "geometry")  # fmt: skip
    assert [f for f in files_in(tmp_path) if f.endswith("0.npz")] == [
        "geometry/depth/before_00000.npz"
    ]
    assert not list(tmp_path.glob("*.part"))


def test_other_captures_are_refused(
    geometry: Geometry, captures: tuple[Capture, Capture], tmp_path: Path
) -> None:
    save_geometry(geometry, tmp_path / "geometry")
    fewer = Capture("after", "", captures[1].frames[:1])
    with pytest.raises(InputError, match="other captures"):
        load_geometry(tmp_path / "geometry", captures[0], fewer)
    larger = tuple(replace(f, width=2 * WIDTH, height=2 * HEIGHT) for f in captures[0].frames)
    with pytest.raises(InputError, match="320x240, not before0"):
        load_geometry(tmp_path / "geometry", Capture("before", "", larger), captures[1])


def test_damaged_folder_is_named(
    geometry: Geometry, captures: tuple[Capture, Capture], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="does not hold a finished geometry"):
        load_geometry(tmp_path, *captures)
    save_geometry(geometry, tmp_path / "geometry")
    (tmp_path / "geometry/depth/before_00001.npz").write_bytes(b"cut")
    with pytest.raises(InputError, match=r"before_00001\.npz cannot be read"):
        load_geometry(tmp_path / "geometry", *captures)


def test_unwritable_folder_is_named(geometry: Geometry, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot be written"):
        save_geometry(geometry, tmp_path / "file/geometry")
