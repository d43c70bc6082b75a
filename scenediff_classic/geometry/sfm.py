"""Joint structure from motion over both captures: cameras without any prior knowledge.

The classical stand-in for the feed-forward geometry model of the paper (Sec. 4.1). Both captures
go into one reconstruction, because two separate ones would share neither scale nor frame.
"""

import hashlib
import itertools
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from scenediff_classic.errors import AlignmentError, OutputError
from scenediff_classic.geometry import colmap
from scenediff_classic.geometry.colmap import Database, read_model
from scenediff_classic.geometry.focal import vote_focal
from scenediff_classic.geometry.pairing import matching_pairs, meets
from scenediff_classic.geometry.refinement import refine
from scenediff_classic.geometry.registration import (
    FEW_BRIDGE,
    Quality,
    failure,
    frame_reason,
    has_parallax,
    judge,
    usable_frames,
    weak_pictures,
)
from scenediff_classic.geometry.sfm_workspace import Record, SfmWorkspace
from scenediff_classic.geometry.sparse_model import (
    FeatureRecipe,
    MapperRecipe,
    Picture,
    SparseModel,
)
from scenediff_classic.geometry.views import make_view, resize_lens
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.types import (
    VIDEOS,
    Capture,
    Frame,
    Geometry,
    SparsePoints,
    Unregistered,
)

ADJUSTED = 1
"""Raised with each change of the last adjustment or the start: finished work is then made anew."""


@dataclass(frozen=True)
class Rung:
    """One attempt: how to match, and how to compute cameras from the matches."""

    features: FeatureRecipe
    mapper: MapperRecipe

    @property
    def name(self) -> str:
        """For logs and folders."""
        return f"{self.features.name}-{self.mapper.name}"


STANDARD = FeatureRecipe("standard")
SENSITIVE = FeatureRecipe("sensitive", peak_threshold=0.003, ratio=0.85)
THOROUGH = FeatureRecipe("thorough", peak_threshold=0.002, ratio=0.9, affine=True, guided=True)
INCREMENTAL = MapperRecipe("incremental")
RELAXED = MapperRecipe(
    "relaxed", init_inliers=30, init_angle=6.0, pose_inliers=12, two_view_points=True
)
GLOBAL = MapperRecipe("global", method="global")

LADDER: tuple[Rung, ...] = (
    Rung(STANDARD, INCREMENTAL),
    Rung(STANDARD, RELAXED),
    Rung(SENSITIVE, RELAXED),
    Rung(THOROUGH, RELAXED),
    Rung(THOROUGH, GLOBAL),
)
"""From cheap and strict to costly and lenient; the first good result wins."""

TWO_VIEW_LADDER: tuple[Rung, ...] = tuple(
    Rung(features, replace(RELAXED, name="two-view", init_angle=2.0, refine_lens=False))
    for features in (STANDARD, THOROUGH)
)
"""For one photo against one photo: the focal length cannot be refined from a single pair."""


def learned_ladder(weights: Path, pictures: int) -> tuple[Rung, ...]:
    """Rungs with learned features in place of SIFT: only the mapping becomes more lenient."""
    features = FeatureRecipe("aliked", weights=weights)
    if pictures == 2:
        return (Rung(features, TWO_VIEW_LADDER[0].mapper),)
    return tuple(Rung(features, mapper) for mapper in (INCREMENTAL, RELAXED, GLOBAL))


@dataclass(frozen=True)
class StructureFromMotion:
    """Cameras of all frames of both captures in one world frame, by COLMAP.

    Depth stays unknown: it is the business of multi-view stereo. The world's scale and axes are
    arbitrary.
    """

    long_side: int = 512
    """Longer side of the resulting views, in pixels."""
    max_side: int = 1600
    """Longer side at which features are searched, in pixels."""
    seed: int = 0
    """The same seed gives the same cameras."""
    attempts: int = len(LADDER)
    """At most so many rungs of `LADDER` are tried while the result is not good enough."""
    matcher: Literal["sift", "aliked"] = "sift"
    """Features: SIFT, or ALIKED with LightGlue (needs `weights` and a pycolmap with ONNX)."""
    weights: Path | None = None
    """Folder with aliked-n16rot.onnx and aliked-lightglue.onnx; nothing is ever downloaded."""

    def __call__(
        self, before: Capture, after: Capture, workspace: Path, progress: Progress = silent
    ) -> Geometry:
        """Register both captures.

        The COLMAP model ends up in ``workspace/sparse``, its pictures in
        ``workspace/sfm/images``; a finished reconstruction of the same frames is reused.

        Raises
        ------
        AlignmentError
            If before and after do not end up in one reconstruction; the sentence says why.
        InputError
            If learned features are asked for and cannot be used.
        """
        if self.matcher == "aliked":
            colmap.check_learned(self.weights)
        frames = (*before.frames, *after.frames)
        _refuse_identical(frames)
        files = SfmWorkspace(workspace)
        key = self._fingerprint(frames)
        if not files.is_finished(key):
            files.restart(key)
            record = self._climb(frames, files, progress)
            files.finish(key, record)
        record = files.record()
        return self._geometry(frames, read_model(files.sparse), record)

    def _fingerprint(self, frames: Sequence[Frame]) -> str:
        """Tells whether finished work in the workspace is of the same frames and options."""
        digest = hashlib.blake2b(digest_size=16)
        learned = str(self.weights) if self.matcher == "aliked" else None
        options = (self.max_side, self.seed, self.attempts, LADDER, colmap.VERSION, ADJUSTED)
        options = (*options, learned)
        digest.update(repr(options).encode())
        for frame in frames:
            digest.update(repr((_name(frame), frame.image.shape, frame.focal_px)).encode())
            digest.update(frame.image.tobytes())
            if frame.ignore is not None:
                digest.update(np.packbits(frame.ignore).tobytes())
        return digest.hexdigest()

    def _climb(self, frames: Sequence[Frame], files: SfmWorkspace, progress: Progress) -> Record:
        """Try rung after rung; keep the best model and the reasons for what it lacks."""
        pictures = _write_pictures(frames, files)
        ladder = TWO_VIEW_LADDER if len(frames) == 2 else LADDER
        if self.matcher == "aliked" and self.weights is not None:
            ladder = learned_ladder(self.weights, len(frames))
        tried: list[tuple[Quality, Path]] = []
        log: list[str] = []
        database: Database | None = None
        recipes: set[str] = set()
        for rung in ladder[: max(self.attempts, 1)]:
            recipe = replace(rung.features, max_side=self.max_side)
            database = self._matched(pictures, recipe, files, progress)
            models = database.reconstruct(
                files.folder / rung.name,
                rung.mapper,
                # a mapper that starts anew counts on: never show more frames than there are
                lambda n: progress("camera poses", min(n, len(frames)), len(frames)),
            )
            usable = usable_frames(database.feature_counts())
            found = [(judge(read_model(folder), usable), folder) for folder in models]
            tried += found
            outcome = "; ".join(str(quality) for quality, _ in found) or "no model"
            log.append(f"{rung.features.name} features, {rung.mapper.name} mapping: {outcome}.")
            if any(quality.complete for quality, _ in found):
                break
            recipes.add(rung.features.name)
            if len(recipes) > 1 and not meets(database.verified_pairs()):
                log.append("No pair across the captures has real support: later rungs are spared.")
                break
        assert database is not None
        return _conclude(tried, database, files, log)

    def _matched(
        self,
        pictures: tuple[Picture, ...],
        recipe: FeatureRecipe,
        files: SfmWorkspace,
        progress: Progress,
    ) -> Database:
        """The database of a recipe: made once, then shared by all rungs that use it."""
        final = files.folder / f"{recipe.name}.db"
        if final.exists():
            return Database(final, files.images, pictures, self.seed)
        path = final.with_suffix(".part")
        path.unlink(missing_ok=True)
        database = Database(path, files.images, pictures, self.seed)
        database.create()
        names = [picture.name for picture in pictures]
        for start in range(0, len(names), 8):
            progress("features", start, len(names))
            database.extract(names[start : start + 8], files.masks, recipe)
        captures = [[n for n in names if n.startswith(video)] for video in VIDEOS]
        pairs = (
            matching_pairs(captures, database, self.seed)
            if recipe.weights is None  # signatures are made of SIFT descriptors
            else list(itertools.combinations(names, 2))
        )
        for start in range(0, len(pairs), 200):
            progress("matching", start, len(pairs))
            database.match(pairs[start : start + 200], recipe)
        progress("matching", len(pairs), len(pairs))
        _start_focal(database)
        os.replace(path, final)
        return Database(final, files.images, pictures, self.seed)

    def _geometry(self, frames: Sequence[Frame], model: SparseModel, record: Record) -> Geometry:
        """Views in the captures' order; observations renumbered to it."""
        posed = {
            picture.name: number
            for number, picture in enumerate(model.pictures)
            if picture.name not in record.reasons
        }
        views, rank = [], np.full(len(model.pictures), -1)
        for frame in (f for f in frames if _name(f) in posed):
            picture = model.pictures[posed[_name(frame)]]
            rank[posed[picture.name]] = len(views)
            lens = resize_lens(picture.lens, frame.width, frame.height)
            views.append(make_view(frame, lens, picture.cam_from_world, self.long_side))
        points, positions = model.points.observations.T
        kept = rank[positions] >= 0
        observations = np.stack([points[kept], rank[positions][kept]], axis=1)
        return Geometry(
            views=tuple(views),
            points=SparsePoints(model.points.xyz, model.points.rgb, observations),
            unregistered=tuple(
                Unregistered(f.video, f.index, record.reasons[_name(f)])
                for f in frames
                if _name(f) not in posed
            ),
            warnings=record.warnings,
            log=record.log,
        )


def _start_focal(database: Database) -> None:
    """Let the matches say where mapping starts from, for cameras without a known focal length."""
    sides = {p.camera: (p.focal, max(p.width, p.height)) for p in database.pictures}
    known = {camera: focal / side for camera, (focal, side) in sides.items() if focal is not None}
    if len(known) < len(sides):
        database.set_focal(vote_focal(database.epipolar_pairs(), known, tuple(sides)))


def _conclude(
    tried: Sequence[tuple[Quality, Path]],
    database: Database,
    files: SfmWorkspace,
    log: Sequence[str],
) -> Record:
    """The best attempt, or the error that explains why there is none."""
    features, pairs = database.feature_counts(), database.verified_pairs()
    aligned = [(quality, folder) for quality, folder in tried if quality.aligned]
    if not aligned or not has_parallax(pairs):
        reason = failure([quality for quality, _ in tried], features, pairs)
        raise AlignmentError(f"Before and after could not be aligned: {reason}")
    quality, rough = max(aligned, key=lambda attempt: attempt[0].rank)
    folder, outcome = refine(rough, files.folder / "refined", lens=len(database.pictures) > 2)
    if not judge(read_model(folder), quality.total).aligned:
        folder, outcome = rough, "robust adjustment: not sound, left out"
    warnings = []
    if quality.bridge < FEW_BRIDGE:
        warnings.append(
            f"Before and after hang together by only {quality.bridge} points: "
            "their alignment may be inaccurate."
        )
    model = read_model(folder)
    weak = weak_pictures(model)
    posed = {picture.name for picture in model.pictures} - set(weak)
    missing = {picture.name for picture in database.pictures} - posed
    return Record(
        str(folder.relative_to(files.folder)),
        (*log, f"{outcome[0].upper()}{outcome[1:]}."),
        tuple(warnings),
        {name: frame_reason(name, features, pairs, weak) for name in sorted(missing)},
    )


def _name(frame: Frame) -> str:
    return f"{frame.video}/{frame.index:05d}.png"


def _refuse_identical(frames: Sequence[Frame]) -> None:
    if all(np.array_equal(frames[0].image, frame.image) for frame in frames[1:]):
        raise AlignmentError(
            "Before and after could not be aligned: all frames are the same picture "
            "(no parallax): move the camera around the scene while recording."
        )


def _write_pictures(frames: Sequence[Frame], files: SfmWorkspace) -> tuple[Picture, ...]:
    """Write the frames for COLMAP; one camera for each capture, picture size and EXIF focal."""
    pictures = []
    cameras: dict[tuple, int] = {}
    masked = any(frame.ignore is not None for frame in frames)  # COLMAP wants all masks or none
    for frame in frames:
        height, width = frame.image.shape[:2]
        lens = (frame.video, width, height, frame.width, frame.height, frame.focal_px)
        focal = None if frame.focal_px is None else frame.focal_px * width / frame.width
        camera = cameras.setdefault(lens, len(cameras))
        pictures.append(Picture(_name(frame), width, height, camera, focal))
        _write_png(files.images / _name(frame), cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR))
        if masked:
            ignore = np.zeros((height, width), bool) if frame.ignore is None else frame.ignore
            mask = np.where(ignore, 0, 255).astype(np.uint8)
            _write_png(files.masks / f"{_name(frame)}.png", mask)
    return tuple(pictures)


def _write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 1]):
        raise OutputError(f"{path} cannot be written: is the disk full?")
