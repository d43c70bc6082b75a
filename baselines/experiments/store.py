"""What methods share: geometry, regions and features, kept by content outside the data folders.

Layout of the store::

    fingerprints.json                 content of inputs that were read once, by place, size and date
    pairs/<digest>/geometry-<key>/    finished geometry, and <key>.json: what it cost
    regions/, features/               per view, by a digest of the view and the plug-in's options
"""

import hashlib
import json
import time
import typing
from collections.abc import Callable
from dataclasses import dataclass, field, fields, is_dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from data_tools.benchmarks.benchmark import BenchmarkPair
from data_tools.benchmarks.stages import PairStages, digest
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.protocols import FeatureExtractor, Progress, RegionProposer, silent
from scenediff_classic.result.run import json_ready
from scenediff_classic.types import Regions, View
from scenediff_classic.video import fingerprint
from scenediff_classic.workspace import load_npz, save_npz, write_atomic

_ONLY_LATER = ("similarity", "merge")
"""Options of features that do not decide what they are."""


class Fingerprints:
    """Content hashes of inputs, each file read only once while its size and date stay."""

    def __init__(self, path: Path) -> None:
        """Continue from what `path` holds."""
        self._path = path
        self._known: dict[str, str] = read_json(path) or {}
        self._changed = False

    def capture(self, options: CaptureOptions) -> str:
        """As `CaptureOptions.fingerprint`."""
        masks = self.tree(options.ignore_dir) if options.ignore_dir else ""
        part = f"{options.fps}:{options.start_s}-{options.end_s}"
        return f"{self.tree(options.path)}{masks}@{part}"

    def tree(self, path: Path) -> str:
        """Of a file, or of a folder with all below it.

        Raises
        ------
        InputError
            If it is missing or cannot be read.
        """
        below = [p for p in sorted(path.rglob("*")) if p.is_file()] if path.is_dir() else [path]
        stamps = [
            f"{p.relative_to(path)}:{(s := p.stat()).st_size}:{s.st_mtime_ns}"
            for p in below
            if p.exists()
        ]
        key = digest(str(path.resolve()), stamps)
        if key not in self._known:
            folders = {path, *(p.parent for p in below)} if path.is_dir() else {path}
            found = [f"{p.relative_to(path)}\0{fingerprint(p)}" for p in sorted(folders)]
            self._known[key] = digest(found)
            self._changed = True
        return self._known[key]

    def save(self) -> None:
        """Write what was added."""
        if self._changed:
            write_atomic(self._path, json.dumps(self._known, indent=0) + "\n")
            self._changed = False


def read_json(path: Path) -> dict[str, Any] | None:
    """A JSON object of ours; None where the file is missing or damaged."""
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


def pair_stages(
    pair: BenchmarkPair, identity: tuple[str, ...], store: Path, progress: Progress = silent
) -> PairStages:
    """The stages of a pair, kept in the store under its content.

    Parameters
    ----------
    identity : tuple of str
        Content hashes of both captures, and of the known geometry if it is used.
    """
    folder = store / "pairs" / digest(identity)
    place = pair.known_geometry or pair.before.path
    return PairStages(place, folder, progress, (pair.before, pair.after), identity)


# --- what something cost --------------------------------------------------------------------------


class Stopwatch:
    """Seconds that a piece of work took over all its attempts, also those that were killed."""

    def __init__(self, path: Path) -> None:
        """Continue from what `path` holds."""
        self._path = path
        known = read_json(path) or {}
        self._before = float(known.get("seconds", 0.0))
        self._start = self._written = time.perf_counter()

    def watching(self, progress: Progress) -> Progress:
        """The same progress, by which the time so far is written down every few seconds."""

        def report(stage: str, done: int, total: int) -> None:
            if time.perf_counter() - self._written > 5:
                self.write()
            progress(stage, done, total)

        return report

    def write(self, **more: Any) -> None:
        """Write the seconds so far."""
        self._written = time.perf_counter()
        seconds = self._before + self._written - self._start
        write_atomic(self._path, json.dumps({"seconds": seconds, **more}) + "\n")


@dataclass
class Ledger:
    """Seconds that other methods spent before on what this one was given."""

    saved: dict[str, float] = field(default_factory=dict)

    def add(self, what: str, seconds: float) -> None:
        """Count them under ``shared <what>``."""
        key = f"shared {what}"
        self.saved[key] = self.saved.get(key, 0.0) + seconds


# --- plug-ins that look into the store first ------------------------------------------------------


@dataclass(frozen=True)
class SharedRegions:
    """Regions of another plug-in."""

    inner: RegionProposer
    folder: Path
    ledger: Ledger

    def __call__(self, view: View) -> Regions:
        """Computed once for equal views."""
        path = self.folder / "regions" / _name(view, self.inner)
        arrays = _kept(path, "regions", self.ledger, lambda: _arrays(self.inner(view)))
        return Regions(arrays["labels"], int(arrays["count"]))


@dataclass(frozen=True)
class SharedFeatures:
    """Features of another plug-in."""

    inner: FeatureExtractor
    folder: Path
    ledger: Ledger

    @property
    def similarity(self) -> float:
        """As of the other one."""
        return self.inner.similarity

    @property
    def merge(self) -> float:
        """As of the other one."""
        return self.inner.merge

    def __call__(self, view: View) -> Float32[np.ndarray, "h w c"]:
        """Computed once for equal views."""
        path = self.folder / "features" / _name(view, self.inner)
        arrays = _kept(path, "features", self.ledger, lambda: {"grid": self.inner(view)})
        return arrays["grid"]


def shared(config: Any, share: tuple[str, ...], folder: Path, ledger: Ledger) -> Any:
    """The configuration with its plug-ins for regions and features replaced by shared ones."""
    hints = typing.get_type_hints(type(config))
    changed: dict[str, Any] = {}
    for item in fields(config):
        value, annotation = getattr(config, item.name), hints[item.name]
        if annotation is RegionProposer:
            if "regions" in share:
                changed[item.name] = SharedRegions(value, folder, ledger)
        elif annotation is FeatureExtractor:
            if "features" in share:
                changed[item.name] = SharedFeatures(value, folder, ledger)
        elif item.name != "geometry" and is_dataclass(value) and not isinstance(value, type):
            inner = shared(value, share, folder, ledger)
            if inner is not value:
                changed[item.name] = inner
    return replace(config, **changed) if changed else config


def _arrays(regions: Regions) -> dict[str, np.ndarray]:
    return {"labels": regions.labels, "count": np.array(regions.count)}


def _kept(
    path: Path, what: str, ledger: Ledger, make: Callable[[], dict[str, np.ndarray]]
) -> dict[str, np.ndarray]:
    found = load_npz(path)
    if found is not None:
        ledger.add(what, float(found.pop("seconds")))
        return found
    start = time.perf_counter()
    made = make()
    save_npz(
        path, compress=what == "regions", **made, seconds=np.array(time.perf_counter() - start)
    )
    return made


def _name(view: View, plug_in: Any) -> str:
    """A file for what a plug-in makes of a view; both may lie anywhere."""
    found = hashlib.sha256()
    for item in fields(view):
        value = getattr(view, item.name)
        if isinstance(value, np.ndarray):
            found.update(f"{item.name} {value.dtype} {value.shape}".encode())
            found.update(np.ascontiguousarray(value).data)
    options = {k: v for k, v in json_ready(plug_in).items() if k not in _ONLY_LATER}
    files = [fingerprint(path) for path in getattr(plug_in, "files", ())]
    found.update(digest(version("scenediff-classic"), options, files).encode())
    key = found.hexdigest()[:32]
    return f"{key[:2]}/{key}.npz"
