"""Finished structure from motion on disk, so that a second run continues from there."""

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from scenediff_classic.errors import OutputError


@dataclass(frozen=True)
class Record:
    """What is kept beside a finished model."""

    model: str
    log: tuple[str, ...]
    warnings: tuple[str, ...]
    reasons: dict[str, str]


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
        }
        _write_json(self._marker, content)

    def record(self) -> Record:
        content = self._read(self._marker)
        return Record(
            content["model"],
            tuple(content["log"]),
            tuple(content["warnings"]),
            content["reasons"],
        )

    @staticmethod
    def _read(path: Path) -> dict:
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def _write_json(path: Path, content: dict) -> None:
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(content, indent=1), encoding="utf-8")
    os.replace(partial, path)
