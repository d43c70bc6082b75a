"""How accurate and how costly stereo is, on the small textured room: prints a table.

Run with ``pytest -m slow -s tests/benchmarks/test_stereo_accuracy.py``. With the environment
variable SCENEDIFF_SYNTHETIC naming a folder of rendered pairs, their first capture is used too.
"""

import os
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from scenediff_classic.geometry.completion import DepthCompletion
from scenediff_classic.geometry.patchmatch import DepthMap, PatchMatchStereo
from scenediff_classic.geometry.view_selection import observed_points, select_sources
from scenediff_classic.protocols import silent
from scenediff_classic.types import Geometry, Lens, SparsePoints, View
from tests.geometry.textured_room import room

Truth = tuple[np.ndarray, ...]


def rendered_capture(folder: Path) -> tuple[Geometry, Truth]:
    """The "before" capture of a rendered pair, with true cameras and no sparse points."""
    with np.load(folder / "truth_geometry.npz") as stored:
        before = np.flatnonzero(stored["video"] == 0)
        cameras = stored["intrinsics"][before], stored["cam_from_world"][before]
        depth, index = stored["depth"][before], stored["index"][before]
    views = []
    for K, pose, number in zip(*cameras, index, strict=True):
        name = f"{number:04d}.png"
        image = cv2.cvtColor(cv2.imread(str(folder / "before" / name)), cv2.COLOR_BGR2RGB)
        shape = image.shape[:2]
        views.append(
            View(
                video="before", index=int(number), name=name, image=image, intrinsics=K,
                cam_from_world=pose, depth=np.full(shape, np.nan, np.float32),
                confidence=np.zeros(shape, np.float32), measured=np.zeros(shape, bool),
                ignore=np.zeros(shape, bool), lens=Lens(shape[1], shape[0], K, np.zeros(4)),
            )
        )  # fmt: skip
    return Geometry(tuple(views), SparsePoints.none()), tuple(depth.astype(np.float32))


def captures() -> list[tuple[str, Geometry, Truth]]:
    """What is measured: (name, geometry without depth, true depth)."""
    found = [("textured room 160x120", *room(height=120, width=160, count=6))]
    folder = os.environ.get("SCENEDIFF_SYNTHETIC")
    for pair in sorted(Path(folder).iterdir()) if folder else []:
        if (pair / "truth_geometry.npz").is_file():
            found.append((pair.name, *rendered_capture(pair)))
    return found


def within(depth: np.ndarray, truth: np.ndarray) -> str:
    """Shares of finite depth within 1, 2 and 5 % of the truth."""
    known = np.isfinite(depth)
    error = np.abs(depth[known] / truth[known] - 1)
    return " ".join(f"{100 * np.mean(error < limit):5.1f}" for limit in (0.01, 0.02, 0.05))


def unconfirmed(stereo: PatchMatchStereo, geometry: Geometry) -> list[DepthMap]:
    """Depth of every view before the views are compared."""
    seen = observed_points(geometry)
    maps = []
    for i, view in enumerate(geometry.views):
        chosen = select_sources(geometry, i, count=stereo.sources, min_own=stereo.min_own_views)
        others = [geometry.views[s] for s in chosen]
        maps.append(stereo.depth_map(view, others, geometry.points.xyz[seen[i]]))
    return maps


@pytest.mark.slow
def test_stereo_accuracy_table(tmp_path: Path) -> None:
    stereo = PatchMatchStereo()
    print("\nshares of pixels within 1 / 2 / 5 % of the true depth")
    for name, geometry, truths in captures():
        truth = np.stack(truths)
        started = time.process_time()
        raw = np.stack([found.depth for found in unconfirmed(stereo, geometry)])
        seconds = (time.process_time() - started) / len(truth)
        solved = stereo(geometry, tmp_path / name, silent)
        kept = np.stack([v.depth for v in solved.views])
        measured = np.isfinite(kept)
        full = np.stack([v.depth for v in DepthCompletion()(solved).views])
        guessed = np.where(measured, np.nan, full)
        print(f"{name}: {seconds:.1f} CPU s a frame (with compilation, the first time)")
        print(f"  before confirmation   {within(raw, truth)}")
        print(f"  measured {measured.mean():6.1%}      {within(kept, truth)}")
        print(f"  guessed  {np.isfinite(guessed).mean():6.1%}      {within(guessed, truth)}")
        error = np.abs(kept[measured] / truth[measured] - 1)
        assert measured.mean() > 0.5
        assert np.mean(error < 0.02) > 0.9


def test_reader_of_rendered_captures(tmp_path: Path) -> None:
    geometry, truth = room(height=24, width=32, count=2)
    (tmp_path / "before").mkdir()
    for view in geometry.views:
        bgr = cv2.cvtColor(view.image, cv2.COLOR_RGB2BGR)
        cv2.imwrite(str(tmp_path / "before" / f"{view.index:04d}.png"), bgr)
    np.savez(
        tmp_path / "truth_geometry.npz",
        intrinsics=np.stack([v.intrinsics for v in geometry.views] * 2),
        cam_from_world=np.stack([v.cam_from_world for v in geometry.views] * 2),
        depth=np.stack(truth * 2), video=[0, 0, 1, 1], index=[0, 1, 0, 1],
    )  # fmt: skip
    read, depth = rendered_capture(tmp_path)
    assert len(read.views) == len(depth) == 2
    for a, b in zip(read.views, geometry.views, strict=True):
        np.testing.assert_array_equal(a.image, b.image)
        np.testing.assert_array_equal(a.cam_from_world, b.cam_from_world)
    assert within(np.stack(truth), np.stack(depth)).split() == ["100.0"] * 3
