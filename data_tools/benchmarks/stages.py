"""The costly stages of a rendered pair, each computed once for equal options and kept on disk.

Every file is named after a digest of what decides its content (pictures, options, version), so a
killed run continues, and rows of a table that share a stage share its file.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from scenediff_classic.change.scale import normalised
from scenediff_classic.change.scoring import (
    RegionScores,
    Scores,
    ScoringConfig,
    reweighted,
    score_changes,
)
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.geometry.store import SavedGeometry, load_geometry, save_geometry
from scenediff_classic.pipeline import DetectConfig
from scenediff_classic.protocols import GeometryEstimator, Progress, silent
from scenediff_classic.result.run import json_ready
from scenediff_classic.types import VIDEOS, Capture, Geometry, Regions, ScoreMaps
from scenediff_classic.video import fingerprint, read_capture
from scenediff_classic.workspace import load_npz, save_npz

_WEIGHTS = ("geometry_weight", "feature_weight", "region_weight", "voxel")
"""Options of scoring that `reweighted` changes afterwards."""
_LIMITS = ("similarity", "merge")
"""Options of features that only the quick half of the method reads."""


@dataclass(frozen=True)
class Stages:
    """What the quick half of the method (`pipeline.decided`) starts from."""

    geometry: Geometry
    """In normalised units."""
    regions: tuple[Regions, ...]
    scores: Scores


@runtime_checkable
class DerivedGeometry(Protocol):
    """A source of geometry that alters another one, which is worth keeping as well."""

    @property
    def estimated(self) -> GeometryEstimator:
        """The other one."""
        ...

    def derived(self, geometry: Geometry, before: Capture, after: Capture) -> Geometry:
        """Alter what the other one gave."""
        ...


class PairStages:
    """The stages of one pair; what was asked for once stays in memory."""

    def __init__(
        self,
        pair: Path,
        folder: Path,
        progress: Progress = silent,
        captures: tuple[CaptureOptions, CaptureOptions] | None = None,
        identity: Sequence[str] | None = None,
    ) -> None:
        """Read the pair's captures, keep its stages in `folder`.

        Parameters
        ----------
        pair : Path
            A rendered pair; otherwise any path whose place must make no difference to `key`.
        captures, identity
            The captures and `identity`, where it is no rendered pair.
        """
        self.pair = pair
        self._given = captures
        if identity is not None:
            self.identity = [version("scenediff-classic"), *identity]
        self._folder = folder
        self._progress = progress
        self._geometries: dict[str, Geometry] = {}
        self._failures: dict[str, Exception] = {}
        self._regions: dict[str, tuple[Regions, ...]] = {}
        self._scores: dict[str, Scores] = {}

    @cached_property
    def captures(self) -> tuple[Capture, Capture]:
        """Before and after."""
        if self._given is not None:
            first, second = self._given
            return first.read("before", self._progress), second.read("after", self._progress)
        before, after = (read_capture(self.pair / video, video) for video in VIDEOS)
        return before, after

    @cached_property
    def identity(self) -> list[str]:
        """Changes with the pair's pictures and truth, and with the program's version."""
        files = (*VIDEOS, "truth_geometry.npz", "truth_instances.npz")
        present = [self.pair / name for name in files if (self.pair / name).exists()]
        return [version("scenediff-classic"), *(fingerprint(path) for path in present)]

    def __call__(self, config: DetectConfig, workspace: str) -> Stages:
        """Compute what is not there yet.

        Parameters
        ----------
        workspace : str
            Name of the folder in which the source of geometry keeps its own finished work; the
            same layout as a workspace of `pipeline.detect_changes`.
        """
        geometry = normalised(self.geometry(config.geometry, workspace))
        regions = self._proposed(config, geometry)
        scores = self._scored(config, geometry, regions)
        return Stages(geometry, regions, scores)

    def key(self, *options: Any) -> str:
        """Name of what these options make of the pair, wherever the pair lies."""
        text = json.dumps([json_ready(option) for option in options], sort_keys=True)
        return digest(self.identity, text.replace(json.dumps(str(self.pair))[1:-1], "<pair>"))

    def geometry_folder(self, source: GeometryEstimator) -> Path:
        """Where the geometry of a source is kept once it is finished."""
        return self._folder / f"geometry-{self.key(source)}"

    def geometry(self, source: GeometryEstimator, workspace: str) -> Geometry:
        """As the source gives it, in its own unit; see `__call__` for the workspace."""
        key = self.key(source)
        if key in self._failures:  # it would fail the same way for every row
            raise self._failures[key]
        if key not in self._geometries:
            folder = self.geometry_folder(source)
            try:
                if SavedGeometry.found_in(folder):
                    found = load_geometry(folder, *self.captures)
                else:
                    found = self._estimated(source, workspace)
                    save_geometry(found, folder)
            except Exception as error:
                self._failures[key] = error
                raise
            self._geometries[key] = found
        return self._geometries[key]

    def _estimated(self, source: GeometryEstimator, workspace: str) -> Geometry:
        if isinstance(source, DerivedGeometry):
            return source.derived(self.geometry(source.estimated, workspace), *self.captures)
        scratch = self._folder / workspace
        scratch.mkdir(parents=True, exist_ok=True)
        return source(*self.captures, scratch, self._progress)

    def _proposed(self, config: DetectConfig, geometry: Geometry) -> tuple[Regions, ...]:
        key = self.key(config.geometry, config.regions)
        if key not in self._regions:
            path = self._folder / f"regions-{key}.npz"
            kept = load_npz(path)
            if kept is None:
                found = tuple(config.regions(view) for view in geometry.views)
                save_npz(path, compress=True, **{f"{k:05d}": r.labels for k, r in enumerate(found)})
            else:
                found = tuple(_as_regions(kept[name]) for name in sorted(kept))
            self._regions[key] = found
        return self._regions[key]

    def _scored(
        self,
        config: DetectConfig,
        geometry: Geometry,
        regions: tuple[Regions, ...],
    ) -> Scores:
        plain = ScoringConfig()
        scoring = replace(config.scoring, **{name: getattr(plain, name) for name in _WEIGHTS})
        features = {k: v for k, v in json_ready(config.features).items() if k not in _LIMITS}
        key = self.key(config.geometry, config.regions, features, scoring)
        if key not in self._scores:
            path = self._folder / f"scores-{key}.npz"
            kept = load_npz(path)
            if kept is None or "light" not in kept:
                found = score_changes(geometry, regions, config.features, scoring, self._progress)
                save_npz(path, compress=True, **_arrays(found))
            else:
                found = _as_scores(kept)
            self._scores[key] = found
        if scoring == config.scoring:
            return self._scores[key]
        return reweighted(self._scores[key], geometry, regions, config.scoring)


def digest(*parts: Any) -> str:
    """Short name for plain JSON values."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def _as_regions(labels: np.ndarray) -> Regions:
    return Regions(labels, int(labels.max(initial=-1)) + 1)


def _arrays(scores: Scores) -> dict[str, np.ndarray]:
    arrays = {"pairs": np.array(scores.pairs, np.int64).reshape(-1, 2)}
    arrays["light"] = np.array(scores.light)
    for (a, b), values in scores.comparisons.items():
        arrays[f"comparison {a} {b}"] = values
    for kind, items in (("map", scores.maps), ("regions", scores.regions)):
        for k, item in enumerate(items):
            for part in fields(item):
                arrays[f"{kind} {k} {part.name}"] = getattr(item, part.name)
    return arrays


def _as_scores(arrays: dict[str, np.ndarray]) -> Scores:
    comparisons: dict[tuple[int, int], np.ndarray] = {}
    parts: dict[tuple[str, int], dict[str, np.ndarray]] = {}
    for name, values in arrays.items():
        match name.split():
            case ["comparison", a, b]:
                comparisons[int(a), int(b)] = values
            case [kind, k, part]:
                parts.setdefault((kind, int(k)), {})[part] = values
    views = range(len(parts) // 2)
    pairs = tuple((int(a), int(b)) for a, b in arrays["pairs"])
    maps = tuple(ScoreMaps(**parts["map", k]) for k in views)
    regions = tuple(RegionScores(**parts["regions", k]) for k in views)
    return Scores(maps, regions, pairs, comparisons, float(arrays["light"]))
