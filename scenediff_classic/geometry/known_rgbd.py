"""Depth-camera recordings with poses, in the layouts of 7-Scenes and TUM RGB-D."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from scenediff_classic.cameras import world_from_cam
from scenediff_classic.errors import InputError
from scenediff_classic.geometry.checked import pinhole, read_numbers, rigid_pose
from scenediff_classic.geometry.views import assemble, make_view
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.types import Capture, Frame, Geometry, Lens, View

TIME_TOLERANCE_S = 0.03
"""Largest gap between a colour picture and its depth or pose: one frame at 30 fps."""


@dataclass(frozen=True)
class RgbdGeometry:
    """A folder with a 16-bit depth picture and a pose for each colour picture.

    Two layouts are told apart by their files:

    * 7-Scenes: ``<stem>.depth.png`` and ``<stem>.pose.txt`` (4x4 camera-to-world) for a colour
      picture ``<stem>.color.png`` (or ``<stem>.<suffix>``);
    * TUM RGB-D: ``depth.txt`` and ``groundtruth.txt`` (``time tx ty tz qx qy qz qw``,
      camera-to-world), colour pictures named by their time.

    Where `path` has subfolders ``before`` and ``after``, each capture uses its own. Depth must be
    registered to colour.
    """

    path: Path
    long_side: int = 512
    depth_scale: float = 1000.0
    """Value that means one metre: 1000 for millimetres, 5000 for TUM."""
    intrinsics: tuple[float, float, float, float] | None = None
    """fx, fy, cx, cy of the colour pictures; default: ``camera-intrinsics.txt`` in `path`."""
    far: float = 20.0
    """Larger depths (metres) mean "no reading": 7-Scenes marks them with 65535."""

    @staticmethod
    def found_in(path: Path) -> bool:
        """True if the folder looks like such a recording."""
        folders = [path, path / "before"]
        return any(
            any(folder.glob("*.pose.txt")) or (folder / "groundtruth.txt").is_file()
            for folder in folders
        )

    def __call__(
        self, before: Capture, after: Capture, workspace: Path, progress: Progress = silent
    ) -> Geometry:
        """Read pose and depth of every frame that has both."""
        if not self.path.is_dir():
            raise InputError(f"{self.path} is not a folder.")
        if self.depth_scale <= 0:
            raise InputError("The depth scale must be positive.")
        recordings = {v: _recording(self._folder(v)) for v in ("before", "after")}
        return assemble(
            before,
            after,
            lambda frame: self._view(frame, recordings[frame.video]),
            "no pose or depth for it",
            str(self.path),
        )

    def _folder(self, video: str) -> Path:
        own = self.path / video
        return own if own.is_dir() else self.path

    def _view(self, frame: Frame, recording: "_SevenScenes | _Tum") -> View | None:
        found = recording.find(frame.name)
        if found is None:
            return None
        world_from_camera, depth_path = found
        depth = _read_depth(depth_path) / np.float32(self.depth_scale)
        depth[depth > self.far] = 0
        lens = Lens(frame.width, frame.height, self._intrinsics(frame.video), np.zeros(4))
        pose = world_from_cam(rigid_pose(world_from_camera, f"{frame.name} in {self.path}"))
        return make_view(frame, lens, pose, self.long_side, depth)

    def _intrinsics(self, video: str) -> Float64[np.ndarray, "3 3"]:
        if self.intrinsics is not None:
            fx, fy, cx, cy = self.intrinsics
            return pinhole(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), str(self.path))
        for folder in (self._folder(video), self.path):
            path = folder / "camera-intrinsics.txt"
            if path.is_file():
                return pinhole(read_numbers(path), str(path))
        raise InputError(
            f"{self.path} has no camera-intrinsics.txt (3x3): add it, or give fx, fy, cx, cy."
        )


@dataclass(frozen=True)
class _SevenScenes:
    folder: Path

    def find(self, name: str) -> tuple[Float64[np.ndarray, "4 4"], Path] | None:
        """Camera-to-world and depth file of a colour picture."""
        stem = Path(name).stem.removesuffix(".color")
        pose, depth = self.folder / f"{stem}.pose.txt", self.folder / f"{stem}.depth.png"
        if not (pose.is_file() and depth.is_file()):
            return None
        return read_numbers(pose), depth


@dataclass(frozen=True)
class _Tum:
    folder: Path
    pose_times: Float64[np.ndarray, "n"]
    poses: Float64[np.ndarray, "n 7"]
    depth_times: Float64[np.ndarray, "m"]
    depth_files: tuple[str, ...]

    @staticmethod
    def read(folder: Path) -> "_Tum":
        poses = read_numbers(folder / "groundtruth.txt")
        if poses.shape[1] != 8:
            raise InputError(f"{folder / 'groundtruth.txt'} must have 8 numbers a line.")
        listing = folder / "depth.txt"
        try:
            lines = [line.split() for line in listing.read_text(encoding="utf-8").splitlines()]
            rows = [(float(line[0]), line[1]) for line in lines if line and line[0][0] != "#"]
        except (OSError, ValueError, IndexError) as error:
            raise InputError(f"{listing} must have a time and a file name a line.") from error
        times, files = zip(*rows, strict=True) if rows else ((), ())
        return _Tum(folder, poses[:, 0], poses[:, 1:], np.array(times), tuple(files))

    def find(self, name: str) -> tuple[Float64[np.ndarray, "4 4"], Path] | None:
        """Pose and depth file nearest in time to a colour picture named by its time."""
        try:
            time = float(Path(name).stem)
        except ValueError:
            return None
        pose, depth = _nearest(self.pose_times, time), _nearest(self.depth_times, time)
        if pose is None or depth is None:
            return None
        return _from_quaternion(self.poses[pose]), self.folder / self.depth_files[depth]


def _recording(folder: Path) -> _SevenScenes | _Tum:
    if (folder / "groundtruth.txt").is_file():
        return _Tum.read(folder)
    return _SevenScenes(folder)


def _nearest(times: Float64[np.ndarray, "n"], time: float) -> int | None:
    if len(times) == 0:
        return None
    nearest = int(np.argmin(np.abs(times - time)))
    return nearest if abs(times[nearest] - time) <= TIME_TOLERANCE_S else None


def _from_quaternion(pose: Float64[np.ndarray, "7"]) -> Float64[np.ndarray, "4 4"]:
    """4x4 transform of (tx, ty, tz, qx, qy, qz, qw)."""
    x, y, z, w = pose[3:] / np.linalg.norm(pose[3:])
    out = np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, 3] = pose[:3]
    return out


def _read_depth(path: Path) -> Float32[np.ndarray, "h w"]:
    depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if depth is None or depth.ndim != 2:
        raise InputError(f"{path} cannot be read as a depth picture with one channel.")
    return depth.astype(np.float32)
