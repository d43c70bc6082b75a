"""Stereo on a real pair with measured depth: Middlebury 2014 "Motorcycle", quarter size."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from scenediff_classic.geometry.stereo.completion import DepthCompletion
from scenediff_classic.geometry.stereo.depth_map import Matcher
from scenediff_classic.geometry.stereo.multi_view import MultiViewStereo
from scenediff_classic.geometry.stereo.patchmatch import PatchMatch
from scenediff_classic.geometry.stereo.plane_sweep import PlaneSweep
from scenediff_classic.protocols import silent
from scenediff_classic.types import Geometry, Lens, SparsePoints, Video, View

BASELINE_M, FOCAL_PX, SHIFT_PX = 0.193001, 994.978, 31.086
"""From the pair's calibration file; `SHIFT_PX` is how far apart the principal points are."""


def rectified_view(video: Video, path: Path, principal_x: float, offset_m: float) -> View:
    """One picture of the pair, its camera `offset_m` to the right of the left one's."""
    image = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    height, width = image.shape[:2]
    # The calibration counts from the centre of the first pixel; here that is (0.5, 0.5).
    K = np.array([[FOCAL_PX, 0, principal_x + 0.5], [0, FOCAL_PX, 254.877 + 0.5], [0, 0, 1]])
    pose = np.eye(4)
    pose[0, 3] = -offset_m
    nothing = np.zeros((height, width), bool)
    unknown = np.full((height, width), np.nan, np.float32)
    return View(
        video=video, index=0, name=path.name, image=image, intrinsics=K, cam_from_world=pose,
        depth=unknown, confidence=np.zeros_like(unknown), measured=nothing, ignore=nothing,
        lens=Lens(width, height, K, np.zeros(4)),
    )  # fmt: skip


def bad_share(depth: np.ndarray, disparity: np.ndarray, limit_px: float) -> float:
    """Share of the pixels of known disparity that are off by more than `limit_px` or have none."""
    found = BASELINE_M * FOCAL_PX / depth - SHIFT_PX
    error = np.abs(found - disparity)[np.isfinite(disparity)]
    return float(np.mean(np.isnan(error) | (error > limit_px)))


@pytest.mark.slow
@pytest.mark.parametrize("matcher", [PatchMatch(), PlaneSweep()], ids=lambda m: type(m).__name__)
def test_two_view_stereo_on_a_real_pair(matcher: Matcher, real_data: Path, tmp_path: Path) -> None:
    folder = real_data / "motorcycle_stereo"
    left = rectified_view("before", folder / "motorcycle_left.png", 311.193, 0.0)
    right = rectified_view("after", folder / "motorcycle_right.png", 311.193 + SHIFT_PX, BASELINE_M)
    with np.load(folder / "motorcycle_disp.npz") as stored:
        disparity = stored[stored.files[0]].astype(np.float64)
    disparity[~np.isfinite(disparity)] = np.nan
    geometry = Geometry((left, right), SparsePoints.none())
    view = MultiViewStereo(matcher)(geometry, tmp_path, silent).views[0]
    known = np.isfinite(disparity)
    error = np.abs(view.depth * (disparity + SHIFT_PX) / (BASELINE_M * FOCAL_PX) - 1)
    shares = [np.mean(error[known & view.measured] < limit) for limit in (0.01, 0.02, 0.05)]
    kept = np.mean(view.measured[known])
    bad = bad_share(view.depth, disparity, 2.0)
    completed = bad_share(DepthCompletion().complete(view).depth, disparity, 2.0)
    print(f"measured {kept:.3f} of the known pixels; within 1 / 2 / 5 %: {shares}")
    print(f"bad-2.0: {bad:.4f} measured, {completed:.4f} with completion")
    assert kept > 0.85
    assert shares[1] > 0.94
    assert bad <= 0.15
    assert completed <= 0.09
