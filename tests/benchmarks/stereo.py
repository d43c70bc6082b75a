"""How accurate, how sure and how costly stereo is on rendered captures with true cameras.

``python -m tests.benchmarks.stereo PAIR... [--width 320]`` prints one line a pair (folders that
``data_tools.synthetic_pairs`` wrote), the means, and how often depth of a given confidence is
right. Search ranges come from features with their true depth, as registration would give them.
"""

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import pytest
import tyro
from jaxtyping import Bool, Float, Float32, Float64

from scenediff_classic.cameras import project, scale_intrinsics
from scenediff_classic.evaluation.calibration import reliability
from scenediff_classic.geometry.stereo import kernels, kernels_reference
from scenediff_classic.geometry.stereo.depth_confidence import RIGHT
from scenediff_classic.geometry.stereo.multi_view import MultiViewStereo, StereoWork
from scenediff_classic.geometry.stereo.patchmatch import PatchMatch
from scenediff_classic.geometry.stereo.pyramid import pictures_at
from scenediff_classic.geometry.stereo.windows import prepare_windows
from scenediff_classic.protocols import silent
from scenediff_classic.types import VIDEOS, Geometry, Lens, SparsePoints, Video, View
from tests.geometry.textured_room import room

Truth = tuple[Float32[np.ndarray, "h w"], ...]

GATHERS_PER_CYCLE = 2
"""Loads a core of today can start in a cycle; a bilinear sample needs four."""


def rendered_capture(
    folder: Path, video: Video = "before", width: int = 0
) -> tuple[Geometry, Truth]:
    """One capture of a rendered pair with true cameras, and its true depth.

    Parameters
    ----------
    width : int
        Width of the pictures: a whole fraction of the rendered one; 0 = as rendered.
    """
    with np.load(folder / "truth_geometry.npz") as stored:
        chosen = np.flatnonzero(stored["video"] == VIDEOS.index(video))
        intrinsics, poses = stored["intrinsics"][chosen], stored["cam_from_world"][chosen]
        depth, index = stored["depth"][chosen].astype(np.float32), stored["index"][chosen]
    names = [f"{number:04d}.png" for number in index]
    pictures = [
        cv2.cvtColor(cv2.imread(str(folder / video / name)), cv2.COLOR_BGR2RGB) for name in names
    ]
    full = [
        _view(video, int(i), name, picture, K, pose)
        for i, name, picture, K, pose in zip(index, names, pictures, intrinsics, poses, strict=True)
    ]
    points = _features(full, depth)
    factor = pictures[0].shape[1] // width if width else 1
    views = tuple(_shrunk(view, factor) for view in full)
    return Geometry(views, points), tuple(_shrunk_depth(d, factor) for d in depth)


def _view(
    video: Video, index: int, name: str, image: np.ndarray, K: np.ndarray, pose: np.ndarray
) -> View:
    shape = image.shape[:2]
    return View(
        video=video, index=index, name=name, image=image, intrinsics=K, cam_from_world=pose,
        depth=np.full(shape, np.nan, np.float32), confidence=np.zeros(shape, np.float32),
        measured=np.zeros(shape, bool), ignore=np.zeros(shape, bool),
        lens=Lens(shape[1], shape[0], K, np.zeros(4)),
    )  # fmt: skip


def _shrunk(view: View, factor: int) -> View:
    height, width = (n // factor for n in view.shape)
    image = cv2.resize(view.image, (width, height), interpolation=cv2.INTER_AREA)
    K = scale_intrinsics(view.intrinsics, 1 / factor, 1 / factor)
    return _view(view.video, view.index, view.name, image, K, view.cam_from_world)


def _shrunk_depth(depth: Float32[np.ndarray, "h w"], factor: int) -> Float32[np.ndarray, "h2 w2"]:
    """Depth of blocks of pixels that lie on one surface; NaN at its edges."""
    height, width = (n // factor for n in depth.shape)
    blocks = depth.reshape(height, factor, width, factor).swapaxes(1, 2).reshape(height, width, -1)
    flat = blocks.max(axis=-1) < blocks.min(axis=-1) * 1.02
    return np.where(flat, 1 / np.mean(1 / blocks, axis=-1), np.nan).astype(np.float32)


def _features(views: Sequence[View], depths: Float32[np.ndarray, "n h w"]) -> SparsePoints:
    """A third of the SIFT features of every view at their true depth, seen where they are."""
    xyz, observations, start = [], [], 0
    for view, depth in zip(views, depths, strict=True):
        grey = cv2.cvtColor(view.image, cv2.COLOR_RGB2GRAY)
        xy = np.array([k.pt for k in cv2.SIFT_create(1500).detect(grey)]).reshape(-1, 2)[::3] + 0.5
        cols, rows = xy.astype(int).T
        rays = np.c_[xy, np.ones(len(xy))] @ np.linalg.inv(view.intrinsics).T
        in_cam = rays * depth[rows, cols][:, None]
        world = (in_cam - view.cam_from_world[:3, 3]) @ view.cam_from_world[:3, :3]
        for position, other in enumerate(views):
            seen = _visible(world, other, depths[position])
            observations += [(start + i, position) for i in np.flatnonzero(seen)]
        xyz.append(world)
        start += len(world)
    return SparsePoints(
        np.concatenate(xyz), np.zeros((start, 3), np.uint8), np.array(observations, np.int64)
    )


def _visible(
    points: Float64[np.ndarray, "n 3"], view: View, depth: Float32[np.ndarray, "h w"]
) -> Bool[np.ndarray, "n"]:
    xy, z = project(points, view.intrinsics, view.cam_from_world)
    height, width = depth.shape
    with np.errstate(invalid="ignore"):
        inside = (z > 0) & np.all((xy >= 0) & (xy < (width, height)), axis=1)
    cols, rows = np.where(inside[:, None], xy, 0).astype(int).T
    return inside & (np.abs(depth[rows, cols] / np.where(inside, z, 1) - 1) < 0.01)


@dataclass(frozen=True)
class Figures:
    """What is measured on one capture; shares in percent of the pixels with known depth."""

    cpu_s: float
    """CPU seconds a frame."""
    within_1: float
    """Found depth, before it is confirmed, within 1 % of the truth."""
    within_2: float
    kept: float
    kept_within_2: float
    """Of the kept ones."""
    best_84: float
    """Of the 84 % of which stereo is surest: within 2 % of the truth."""

    def __str__(self) -> str:
        """One row of the table."""
        return (
            f"{self.cpu_s:6.2f}  {self.within_1:6.1f} {self.within_2:6.1f}  {self.kept:6.1f} "
            f"{self.kept_within_2:6.1f}  {self.best_84:6.1f}"
        )


HEADER = "                    CPU s  found: <1 %  <2 %   kept   <2 %  best 84 %: <2 %"


def measure(
    stereo: MultiViewStereo, geometry: Geometry, truth: Truth
) -> tuple[Figures, Float[np.ndarray, "n 2"]]:
    """The figures of one capture, and (confidence, 1 if right) of every pixel with depth."""
    with tempfile.TemporaryDirectory() as folder:
        started = time.process_time()
        solved = stereo(geometry, Path(folder), silent)
        seconds = (time.process_time() - started) / len(truth)
        work = StereoWork.of(stereo, geometry, Path(folder), silent)
        found = work.second_pass(work.first_pass())
        confidence = np.stack([work.confidence(i, found)[0] for i in range(len(found))])
    true, raw = np.stack(truth), np.stack([v.depth for v in found])
    known = np.isfinite(true)
    error = np.nan_to_num(np.abs(raw / true - 1), nan=np.inf)[known]
    kept = np.stack([v.measured for v in solved.views])[known]
    trust = confidence[known]
    surest = np.argsort(-trust, kind="stable")[: int(0.84 * len(trust))]

    def percent(right: np.ndarray) -> float:
        return 100 * float(np.mean(right))

    figures = Figures(
        seconds, percent(error < 0.01), percent(error < RIGHT), percent(kept),
        percent(error[kept] < RIGHT), percent(error[surest] < RIGHT),
    )  # fmt: skip
    has_depth = trust > 0
    return figures, np.c_[trust, error < RIGHT][has_depth]


def speed(geometry: Geometry, truth: Truth) -> str:
    """Cost of judging one plane in one source, against the NumPy twin and against a bound."""
    view, others = geometry.views[0], geometry.views[1:5]
    matcher = PatchMatch()
    pictures = pictures_at(view, others, 1)
    windows = prepare_windows(pictures.reference, matcher.radius, matcher.grey_sigma)
    rules = matcher.rules((0.01, 100.0), 0.01, consistency=0.0)
    planes = np.zeros((*view.shape, 3), np.float32)
    planes[..., 0] = 1 / np.nan_to_num(truth[0], nan=float(np.nanmedian(truth[0])))
    seconds = []
    for module, rows in (
        (kernels, view.shape[0]),
        (kernels, view.shape[0]),
        (kernels_reference, 2),
    ):
        costs = np.empty((rows, view.shape[1]), np.float32)
        started = time.process_time()
        module.score_planes(pictures, windows, rules, planes[:rows], costs)
        seconds.append((time.process_time() - started) / costs.size / len(others))
    samples = len(windows.dx)
    bound = samples * 4 / GATHERS_PER_CYCLE / 3e9
    return (
        f"{1e9 * seconds[1]:.0f} ns a plane and source ({samples} samples): "
        f"{1 / seconds[1] / 1e6:.1f} million pixels x sources a second and core; "
        f"{seconds[2] / seconds[1]:.0f} times the NumPy twin's speed; "
        f"{seconds[1] / bound:.1f} times the {1e9 * bound:.0f} ns that its loads take at 3 GHz"
    )


@dataclass(frozen=True)
class Options:
    """Accuracy, confidence and cost of stereo on rendered captures with true cameras."""

    pairs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    width: int = 320
    video: Video = "before"
    stereo: MultiViewStereo = field(default_factory=lambda: MultiViewStereo(sources=4))


def main(options: Options) -> None:
    """Print the table."""
    warm, _ = room(height=48, width=64, count=3)
    measure(options.stereo, warm, _)  # compiles
    print(HEADER)
    rows, pixels = [], []
    for pair in options.pairs:
        geometry, truth = rendered_capture(pair, options.video, options.width)
        figures, trusted = measure(options.stereo, geometry, truth)
        print(f"{pair.name:>16}  {figures}", flush=True)
        rows.append([*vars(figures).values()])
        pixels.append(trusted)
    print(f"{'mean':>16}  {Figures(*np.mean(rows, axis=0))}")
    trust, right = np.concatenate(pixels).T
    diagram = reliability(trust, right > 0)
    print("\nconfidence, share of the found depth, right within 2 %", *diagram.rows(), sep="\n")
    print(f"expected calibration error {diagram.error:.3f}\n")
    print(speed(*rendered_capture(options.pairs[0], options.video, options.width)))


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
    for a, b in zip(read.views, geometry.views, strict=True):
        np.testing.assert_array_equal(a.image, b.image)
        np.testing.assert_array_equal(a.cam_from_world, b.cam_from_world)
    np.testing.assert_allclose(np.stack(depth), np.stack(truth), rtol=1e-6)
    for point, position in read.points.observations:
        assert _visible(read.points.xyz[[point]], read.views[position], truth[position]).all()
    half, coarse = rendered_capture(tmp_path, width=16)
    assert half.views[0].shape == coarse[0].shape == (12, 16)
    middle = half.views[0].intrinsics[0, 2] / read.views[0].intrinsics[0, 2]
    assert middle == pytest.approx(0.5)
    assert np.nanmax(np.abs(coarse[0] / truth[0][::2, ::2] - 1)) < 0.03


@pytest.mark.slow
def test_stereo_is_accurate_and_knows_how_sure_it_is() -> None:
    geometry, truth = room(height=120, width=160, count=6)
    figures, pixels = measure(MultiViewStereo(), geometry, truth)
    print(f"\n{HEADER}\n{'textured room':>16}  {figures}\n{speed(geometry, truth)}")
    assert figures.within_2 > 80
    assert figures.kept > 40
    assert figures.kept_within_2 > 95
    assert reliability(pixels[:, 0], pixels[:, 1] > 0).error < 0.1


if __name__ == "__main__":
    main(tyro.cli(Options))
