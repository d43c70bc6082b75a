"""Geometry that is already known: from a feed-forward model, a COLMAP project or a depth camera.

Each source is a frozen dataclass with ``__call__``, and gives the same `Geometry` value as
structure from motion with stereo would.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from scenediff_classic.errors import InputError
from scenediff_classic.geometry.checked import pinhole, read_npz, rigid_pose
from scenediff_classic.geometry.known_rgbd import RgbdGeometry
from scenediff_classic.geometry.registration.colmap.models import read_model
from scenediff_classic.geometry.registration.sparse_model import PosedPicture, SparseModel
from scenediff_classic.geometry.store import SavedGeometry
from scenediff_classic.geometry.views import assemble, make_view, resize_lens
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.types import (
    VIDEOS,
    Capture,
    Frame,
    Geometry,
    Lens,
    SparsePoints,
    View,
)


@dataclass(frozen=True)
class KnownGeometry:
    """Whatever kind of known geometry is at `path`."""

    path: Path
    """An ``.npz``, a finished result, a COLMAP model, or a folder with depth and poses."""
    long_side: int = 512
    """Longer side of the resulting views, in pixels."""
    depth_scale: float = 1000.0
    """Depth-camera folders only: value of a depth picture that means one metre."""

    def __call__(
        self, before: Capture, after: Capture, workspace: Path, progress: Progress = silent
    ) -> Geometry:
        """Tell the kind from the files, and read it.

        Raises
        ------
        InputError
            If `path` is none of the known kinds, or does not fit the captures.
        """
        return self._source()(before, after, workspace, progress)

    def _source(self) -> "NpzGeometry | SavedGeometry | ColmapGeometry | RgbdGeometry":
        path = self.path
        if path.suffix == ".npz":
            return NpzGeometry(path, self.long_side)
        if not path.is_dir():
            raise InputError(f"{path} is neither an .npz nor a folder with known geometry.")
        if SavedGeometry.found_in(path):
            return SavedGeometry(path)
        if _model_folder(path) is not None:
            return ColmapGeometry(path, long_side=self.long_side)
        if RgbdGeometry.found_in(path):
            return RgbdGeometry(path, self.long_side, self.depth_scale)
        raise InputError(
            f"{path} holds no known geometry: expected a COLMAP model (cameras.bin or .txt), "
            "*.pose.txt files or groundtruth.txt with depth pictures, or a finished result."
        )


@dataclass(frozen=True)
class NpzGeometry:
    """An ``.npz`` as any feed-forward model can export it.

    Keys: ``intrinsics (n, 3, 3)`` in pixels of the depth maps, ``cam_from_world (n, 3 or 4, 4)``,
    ``depth (n, h, w)``; optionally ``confidence (n, h, w)``, ``video (n,)`` (0 / 1 or
    before / after) and ``index (n,)`` (frame number within its capture, from 0). Without the last
    two, rows are the frames of before, then those of after. ``images`` may be there as well; the
    captures' own pictures are used.
    """

    path: Path
    long_side: int = 512

    def __call__(
        self, before: Capture, after: Capture, workspace: Path, progress: Progress = silent
    ) -> Geometry:
        """Read the archive and match its rows to the captures' frames."""
        arrays = read_npz(self.path)
        count = self._check(arrays)
        rows = self._rows(arrays, count, before, after)
        return assemble(
            before,
            after,
            lambda frame: self._view(frame, arrays, rows),
            f"not in {self.path.name}",
            str(self.path),
        )

    def _check(self, arrays: dict[str, np.ndarray]) -> int:
        """Number of rows; raises InputError if keys or shapes are wrong."""
        missing = sorted({"intrinsics", "cam_from_world", "depth"} - set(arrays))
        if missing:
            raise InputError(f"{self.path} lacks {', '.join(missing)}.")
        count = len(arrays["depth"]) if arrays["depth"].ndim == 3 else -1
        expected = {"intrinsics": {(count, 3, 3)}, "confidence": {arrays["depth"].shape}}
        expected["cam_from_world"] = {(count, 4, 4), (count, 3, 4)}
        expected |= {key: {(count,)} for key in ("video", "index")}
        for key, shapes in expected.items():
            if count < 0 or (key in arrays and arrays[key].shape not in shapes):
                shown = " and ".join(
                    f"{k} {a.shape}" for k, a in arrays.items() if k in {key, "depth"}
                )
                raise InputError(f"{self.path} has arrays that do not fit together: {shown}.")
        return count

    def _rows(
        self, arrays: dict[str, np.ndarray], count: int, before: Capture, after: Capture
    ) -> dict[tuple[str, int], int]:
        """Row of each (video, frame index)."""
        sizes = {"before": len(before.frames), "after": len(after.frames)}
        if ("video" in arrays) != ("index" in arrays):
            raise InputError(f"{self.path} needs both of video and index, or neither.")
        if "video" not in arrays:
            if count != sum(sizes.values()):
                raise InputError(
                    f"{self.path} has {count} rows, but the captures have {sizes['before']} + "
                    f"{sizes['after']} frames: add the arrays video and index."
                )
            keys = [(v, i) for v in VIDEOS for i in range(sizes[v])]
        else:
            keys = list(zip(self._videos(arrays["video"]), arrays["index"].tolist(), strict=True))
        rows = {key: row for row, key in enumerate(keys)}
        if len(rows) < count:
            raise InputError(f"{self.path} names a frame twice in video and index.")
        return rows

    def _videos(self, video: np.ndarray) -> list[str]:
        names = {"0": "before", "1": "after", "before": "before", "after": "after"}
        values = [str(v.decode() if isinstance(v, bytes) else v) for v in video.tolist()]
        if set(values) - set(names):
            raise InputError(f"{self.path}: video must be 0 / 1 or before / after.")
        return [names[value] for value in values]

    def _view(
        self, frame: Frame, arrays: dict[str, np.ndarray], rows: dict[tuple[str, int], int]
    ) -> View | None:
        row = rows.get((frame.video, frame.index))
        if row is None:
            return None
        source = f"{frame.video} frame {frame.index} in {self.path}"
        depth = arrays["depth"][row]
        same_aspect = abs(depth.shape[1] * frame.height / (depth.shape[0] * frame.width) - 1) < 0.03
        if not same_aspect:
            raise InputError(
                f"{source} is {depth.shape[1]}x{depth.shape[0]}, but the picture is "
                f"{frame.width}x{frame.height}: the depth map must cover the whole picture."
            )
        k = pinhole(arrays["intrinsics"][row], source)
        lens = Lens(depth.shape[1], depth.shape[0], k, np.zeros(4))
        confidence = arrays["confidence"][row] if "confidence" in arrays else None
        return make_view(
            frame,
            resize_lens(lens, frame.width, frame.height),
            rigid_pose(arrays["cam_from_world"][row], source),
            self.long_side,
            depth,
            confidence,
        )


@dataclass(frozen=True)
class ColmapGeometry:
    """A COLMAP model (text or binary), with a depth map for each picture.

    Pictures are matched to frames by name: ``before/<name>``, ``<name>``, or
    ``before/00000.png`` as `StructureFromMotion` names them. Depth maps lie in `depth` as
    ``<picture name>.npy``, ``.npz`` (key ``depth``, optionally ``confidence``) or COLMAP's
    ``.geometric.bin`` / ``.photometric.bin``, with or without the picture's own suffix.
    """

    path: Path
    depth: Path | None = None
    """Folder of depth maps; default: ``stereo/depth_maps`` or ``depth`` beside the model."""
    long_side: int = 512

    def __call__(
        self, before: Capture, after: Capture, workspace: Path, progress: Progress = silent
    ) -> Geometry:
        """Read the model and the depth maps."""
        folder = _model_folder(self.path)
        if folder is None:
            raise InputError(f"{self.path} holds no COLMAP model (cameras.bin or cameras.txt).")
        model = read_model(folder)
        posed = {picture.name: n for n, picture in enumerate(model.pictures)}
        frames = (*before.frames, *after.frames)
        chosen = {(f.video, f.index): _find_name(f, frames, posed) for f in frames}
        geometry = assemble(
            before,
            after,
            lambda frame: self._view(frame, chosen[frame.video, frame.index], model, posed),
            "not in the COLMAP model",
            str(folder),
        )
        rank = np.full(len(posed), -1)
        for number, view in enumerate(geometry.views):
            rank[posed[chosen[view.key] or ""]] = number
        point, picture = model.points.observations.T
        kept = np.stack([point, rank[picture]], axis=1)[rank[picture] >= 0]
        points = SparsePoints(model.points.xyz, model.points.rgb, kept)
        return Geometry(
            geometry.views, points, geometry.unregistered, geometry.warnings, geometry.log
        )

    def _view(
        self, frame: Frame, name: str | None, model: SparseModel, posed: dict[str, int]
    ) -> View | None:
        if name is None:
            return None
        picture: PosedPicture = model.pictures[posed[name]]
        depth, confidence = self._depth(name)
        lens = resize_lens(picture.lens, frame.width, frame.height)
        return make_view(frame, lens, picture.cam_from_world, self.long_side, depth, confidence)

    def _depth(
        self, name: str
    ) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"] | None]:
        """Depth and, if given, confidence of a picture."""
        beside = [self.path / "stereo/depth_maps", self.path / "depth", self.path / "depth_maps"]
        folders = [self.depth] if self.depth else beside
        stems = [name, str(Path(name).with_suffix(""))]
        for folder in folders:
            for suffix in (".geometric.bin", ".photometric.bin", ".npz", ".npy"):
                for stem in stems:
                    path = folder / (stem + suffix)
                    if path.is_file():
                        return read_depth(path)
        raise InputError(
            f"No depth map for {name}: looked for {stems[0]}.npy, .npz and .geometric.bin in "
            f"{' and '.join(map(str, folders))}."
        )


def read_depth(
    path: Path,
) -> tuple[Float32[np.ndarray, "h w"], Float32[np.ndarray, "h w"] | None]:
    """A depth map and, in an ``.npz``, its confidence.

    Understands ``.npy``, ``.npz`` and COLMAP's ``.bin`` (text header ``width&height&channels&``,
    then float32, x fastest).
    """
    if path.suffix == ".npz":
        arrays = read_npz(path)
        if "depth" not in arrays:
            raise InputError(f"{path} lacks the array depth.")
        depth, confidence = arrays["depth"], arrays.get("confidence")
    elif path.suffix == ".npy":
        try:
            depth, confidence = np.load(path, allow_pickle=False), None
        except (OSError, ValueError, EOFError) as error:
            raise InputError(f"{path} cannot be read as an .npy array.") from error
    else:
        depth, confidence = _read_colmap_depth(path), None
    if depth.ndim != 2 or (confidence is not None and confidence.shape != depth.shape):
        raise InputError(f"{path} must hold one depth map (h, w), and confidence of that shape.")
    return depth.astype(np.float32), confidence


def _read_colmap_depth(path: Path) -> Float32[np.ndarray, "h w"]:
    header, data = path.read_bytes()[:64].split(b"&")[:3], path.read_bytes()
    try:
        width, height, channels = (int(part) for part in header)
        start = sum(len(part) + 1 for part in header)
        values = np.frombuffer(data, "<f4", offset=start)
        return values.reshape(channels, height, width)[0]
    except ValueError as error:
        raise InputError(f"{path} is not a COLMAP depth map.") from error


def _model_folder(path: Path) -> Path | None:
    """Where in a COLMAP project the model is."""
    for folder in (path, path / "sparse", path / "sparse/0", path / "0"):
        if any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt")):
            return folder
    return None


def _find_name(frame: Frame, frames: Sequence[Frame], posed: dict[str, int]) -> str | None:
    """Name of a frame's picture in the model; plain names only where they are unambiguous."""
    names = [f"{frame.video}/{frame.name}", f"{frame.video}/{frame.index:05d}.png"]
    if sum(other.name == frame.name for other in frames) == 1:
        names.append(frame.name)
    return next((name for name in names if name in posed), None)
