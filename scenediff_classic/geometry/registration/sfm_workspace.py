"""Structure from motion on disk: its pictures, and finished work to continue from."""

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from scenediff_classic.errors import OutputError
from scenediff_classic.geometry.registration.sparse_model import Picture
from scenediff_classic.types import Frame


@dataclass(frozen=True)
class Record:
    """What is kept beside a finished model."""

    model: str
    log: tuple[str, ...]
    warnings: tuple[str, ...]
    reasons: dict[str, str]
    shares: dict[str, float]
    """How much of its matches each picture's camera fits, where that is known."""


@dataclass(frozen=True)
class SfmWorkspace:
    """Where finished work is kept. The marker is written last and names what it belongs to."""

    root: Path

    @property
    def folder(self) -> Path:
        return self.root / "sfm"

    @property
    def images(self) -> Path:
        return self.folder / "images"

    @property
    def masks(self) -> Path:
        return self.folder / "masks"

    @property
    def sparse(self) -> Path:
        return self.root / "sparse"

    @property
    def _marker(self) -> Path:
        return self.folder / "finished.json"

    def is_finished(self, key: str) -> bool:
        return self.sparse.is_dir() and self._read(self._marker).get("key") == key

    def restart(self, key: str) -> None:
        """Forget work on other frames; keep matches of the same ones."""
        begun = self.folder / "begun.json"
        try:
            self._marker.unlink(missing_ok=True)
            if self._read(begun).get("key") != key and self.folder.exists():
                shutil.rmtree(self.folder)
            self.folder.mkdir(parents=True, exist_ok=True)
            _write_json(begun, {"key": key})
        except OSError as error:
            raise OutputError(f"{self.folder} cannot be written: {error.strerror}.") from error

    def finish(self, key: str, record: Record) -> None:
        """Publish the chosen model, then the marker."""
        partial = self.root / "sparse.part"
        shutil.rmtree(partial, ignore_errors=True)
        shutil.copytree(self.folder / record.model, partial)
        shutil.rmtree(self.sparse, ignore_errors=True)
        os.replace(partial, self.sparse)
        content = {
            "key": key,
            "model": record.model,
            "log": record.log,
            "warnings": record.warnings,
            "reasons": record.reasons,
            "shares": record.shares,
        }
        _write_json(self._marker, content)

    def record(self) -> Record:
        content = self._read(self._marker)
        return Record(
            content["model"],
            tuple(content["log"]),
            tuple(content["warnings"]),
            content["reasons"],
            content["shares"],
        )

    @staticmethod
    def _read(path: Path) -> dict:
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def _write_json(path: Path, content: dict) -> None:
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(content, indent=1), encoding="utf-8")
    os.replace(partial, path)


def picture_name(frame: Frame) -> str:
    """Path of a frame's picture below the image folder."""
    return f"{frame.video}/{frame.index:05d}.png"


def write_pictures(frames: Sequence[Frame], files: SfmWorkspace) -> tuple[Picture, ...]:
    """Write the frames for COLMAP; one camera for each capture, picture size and EXIF focal."""
    pictures = []
    cameras: dict[tuple, int] = {}
    masked = any(frame.ignore is not None for frame in frames)  # COLMAP wants all masks or none
    for frame in frames:
        height, width = frame.image.shape[:2]
        lens = (frame.video, width, height, frame.width, frame.height, frame.focal_px)
        focal = None if frame.focal_px is None else frame.focal_px * width / frame.width
        camera = cameras.setdefault(lens, len(cameras))
        name = picture_name(frame)
        pictures.append(Picture(name, width, height, camera, focal))
        _write_png(files.images / name, cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR))
        if masked:
            ignore = np.zeros((height, width), bool) if frame.ignore is None else frame.ignore
            mask = np.where(ignore, 0, 255).astype(np.uint8)
            _write_png(files.masks / f"{name}.png", mask)
    return tuple(pictures)


def _write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
        raise OutputError(f"{path} cannot be written: is the disk full?")
