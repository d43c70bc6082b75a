"""Compare cameras found by structure from motion with known ones.

``python -m data_tools.benchmarks.registration BEFORE AFTER`` registers two captures and says how
many frames found a place; with ``--truth FILE`` it also says how far they are from where they
belong, after the similarity transform that no reconstruction from pictures can know.
"""

import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from jaxtyping import Float64
from rich.console import Console
from rich.table import Table

from scenediff_classic.cameras import camera_centre, world_from_cam
from scenediff_classic.errors import InputError, SceneDiffError
from scenediff_classic.geometry.registration.structure_from_motion import StructureFromMotion
from scenediff_classic.types import VIDEOS, Capture, Frame, Video
from scenediff_classic.video import read_capture

VIDEO_RATE = 30.0
"""Frames a second of the 7-Scenes videos: their pose lists count frames."""
MAX_STRETCH = 0.01
"""Known rotations may stretch by so much: those of 7-Scenes do by up to 0.0002."""


@dataclass(frozen=True)
class PoseErrors:
    """How far cameras are from the known ones, frame by frame."""

    rotation_deg: Float64[np.ndarray, "n"]
    centre: Float64[np.ndarray, "n"]
    """Distance of the centres, in the unit of the known cameras."""
    extent: float
    """Diagonal of the box around the known centres, in the same unit."""


def compare_cameras(
    found: Float64[np.ndarray, "n 4 4"], true: Float64[np.ndarray, "n 4 4"]
) -> PoseErrors:
    """Errors of cameras (cam_from_world) after the best similarity transform of their centres.

    The transform is the least-squares one (Umeyama 1991).

    Raises
    ------
    InputError
        With fewer than three cameras, or all of them on a line, it is not determined.
    """
    a = np.array([camera_centre(c) for c in found]).reshape(-1, 3)
    b = np.array([camera_centre(c) for c in true]).reshape(-1, 3)
    if len(a) < 3:
        raise InputError("Fewer than three cameras have a known pose: they cannot be compared.")
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    u, d, vt = np.linalg.svd((b - mean_b).T @ (a - mean_a) / len(a))
    if d[1] <= 1e-9 * d[0]:
        raise InputError("All cameras lie on one line: they cannot be compared.")
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    turn = u * signs @ vt
    scale = float(d @ signs / np.mean(np.sum((a - mean_a) ** 2, axis=1)))
    moved = scale * (a - mean_a) @ turn.T + mean_b
    residual = true[:, :3, :3] @ turn @ found[:, :3, :3].transpose(0, 2, 1)
    cosine = (np.trace(residual, axis1=1, axis2=2) - 1) / 2
    return PoseErrors(
        np.degrees(np.arccos(np.clip(cosine, -1, 1))),
        np.linalg.norm(moved - b, axis=1),
        float(np.linalg.norm(np.ptp(b, axis=0))),
    )


def read_true_cameras(
    path: Path, before: Capture, after: Capture
) -> dict[tuple[Video, int], Float64[np.ndarray, "4 4"]]:
    """Known cam_from_world by (capture, frame index); frames that the file lacks are left out.

    Parameters
    ----------
    path : Path
        ``truth_geometry.npz`` of a rendered pair; a Middlebury ``*_par.txt`` (name, K, R, t); or
        a 7-Scenes list (frame number of the video, 4x4 camera-to-world).

    Raises
    ------
    InputError
        If the file is none of these.
    """
    frames = (*before.frames, *after.frames)
    try:
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as stored:
                poses = stored["cam_from_world"].astype(np.float64)
            if poses.shape != (len(frames), 4, 4):
                raise InputError(f"{path} does not hold one camera for each of the frames.")
            return {(f.video, f.index): pose for f, pose in zip(frames, poses, strict=True)}
        lines = [line.split() for line in path.read_text().splitlines()]
        rows = {w[0]: np.array(w[1:], float) for w in lines if len(w) > 1 and w[0] != "#"}
        known = {name: _cam_from_world(numbers) for name, numbers in rows.items()}
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise InputError(f"{path} does not hold cameras in a known layout.") from error
    return {(f.video, f.index): known[_row_name(f)] for f in frames if _row_name(f) in known}


def _row_name(frame: Frame) -> str:
    return frame.name if frame.time_s is None else f"{round(frame.time_s * VIDEO_RATE):06d}"


def _nearest_rotation(matrix: Float64[np.ndarray, "3 3"]) -> Float64[np.ndarray, "3 3"]:
    """The rotation with the least squared difference: some written poses stretch a little."""
    u, d, vt = np.linalg.svd(matrix)
    if np.linalg.det(u @ vt) < 0 or np.abs(d - 1).max() > MAX_STRETCH:
        raise ValueError("not a rigid motion")
    return u @ vt


def _cam_from_world(numbers: Float64[np.ndarray, "n"]) -> Float64[np.ndarray, "4 4"]:
    if len(numbers) == 16:
        world_from_camera = numbers.reshape(4, 4)
        world_from_camera[:3, :3] = _nearest_rotation(world_from_camera[:3, :3])
        return world_from_cam(world_from_camera)  # a rigid transform's inverse, either way
    if len(numbers) != 21:
        raise ValueError("neither K, R, t nor a 4x4 matrix")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = numbers[9:18].reshape(3, 3), numbers[18:]
    return pose


@dataclass(frozen=True)
class RegistrationBenchmark:
    """Register two captures and compare the cameras with known ones."""

    before: tyro.conf.Positional[Path]
    """Video, or folder of pictures."""
    after: tyro.conf.Positional[Path]
    truth: Path | None = None
    """File with the known cameras."""
    fps: float = 1.0
    """Frames per second to take of a video."""
    before_range: tuple[float, float] | None = None
    """Seconds of the before video to use: start end."""
    after_range: tuple[float, float] | None = None
    seed: int = 0

    def __call__(self) -> Table:
        """Register, compare, and give the table."""
        captures = {
            "before": self._read(self.before, "before", self.before_range),
            "after": self._read(self.after, "after", self.after_range),
        }
        with tempfile.TemporaryDirectory(prefix="registration-") as folder:
            register = StructureFromMotion(seed=self.seed)
            geometry = register(captures["before"], captures["after"], Path(folder))
        table = Table(title="Registration")
        table.add_column("figure")
        table.add_column("value", justify="right")
        for video in VIDEOS:
            placed = sum(v.video == video for v in geometry.views)
            table.add_row(f"{video} frames placed", f"{placed} of {len(captures[video].frames)}")
        if self.truth is not None:
            true = read_true_cameras(self.truth, captures["before"], captures["after"])
            found = {v.key: v.cam_from_world for v in geometry.views if v.key in true}
            for name, value in _figures(found, true).items():
                table.add_row(name, value)
        for line in (*geometry.log, *geometry.warnings):
            table.add_row("note", line)
        return table

    def _read(self, path: Path, video: Video, part: tuple[float, float] | None) -> Capture:
        start, end = part if part is not None else (0.0, None)
        return read_capture(path, video, fps=self.fps, start_s=start, end_s=end)


def _figures(
    found: Mapping[tuple[Video, int], np.ndarray], true: Mapping[tuple[Video, int], np.ndarray]
) -> dict[str, str]:
    errors = compare_cameras(
        np.stack([found[key] for key in found]) if found else np.zeros((0, 4, 4)),
        np.stack([true[key] for key in found]) if found else np.zeros((0, 4, 4)),
    )
    share = 100 / errors.extent
    return {
        "cameras compared": str(len(found)),
        "rotation error, median": f"{np.median(errors.rotation_deg):.3f} degrees",
        "rotation error, largest": f"{errors.rotation_deg.max():.3f} degrees",
        "centre error, median": f"{np.median(errors.centre) * share:.3f} % of the path's extent",
        "centre error, largest": f"{errors.centre.max() * share:.3f} % of the path's extent",
    }


if __name__ == "__main__":
    try:
        Console().print(tyro.cli(RegistrationBenchmark)())
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
