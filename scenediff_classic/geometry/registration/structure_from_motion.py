"""Joint structure from motion over both captures: cameras without any prior knowledge.

The classical stand-in for the feed-forward geometry model of the paper (Sec. 4.1). Both captures
go into one reconstruction, because two separate ones would share neither scale nor frame.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scenediff_classic.errors import AlignmentError
from scenediff_classic.geometry.registration.agreement import OwnMatches
from scenediff_classic.geometry.registration.ambiguity import check_alignment
from scenediff_classic.geometry.registration.colmap import VERSION
from scenediff_classic.geometry.registration.colmap.database import Database, check_learned
from scenediff_classic.geometry.registration.colmap.growing import own_matches
from scenediff_classic.geometry.registration.colmap.models import read_model
from scenediff_classic.geometry.registration.ladder import LADDER, Rung, ladder
from scenediff_classic.geometry.registration.leftovers import place_leftovers
from scenediff_classic.geometry.registration.matching import matched
from scenediff_classic.geometry.registration.merging import merge
from scenediff_classic.geometry.registration.placement import low_confidence_warning, placements
from scenediff_classic.geometry.registration.quality import (
    Quality,
    bridging,
    failure,
    few_points_warning,
    frame_reason,
    has_parallax,
    has_support,
    judge,
    usable_frames,
    weak_pictures,
)
from scenediff_classic.geometry.registration.refinement import refine
from scenediff_classic.geometry.registration.sfm_workspace import (
    Record,
    SfmWorkspace,
    picture_name,
    write_pictures,
)
from scenediff_classic.geometry.registration.sparse_model import Picture, SparseModel
from scenediff_classic.geometry.views import make_view, resize_lens
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.types import (
    Capture,
    Frame,
    Geometry,
    SparsePoints,
    Unregistered,
    Video,
)

_REVISION = 3
"""Raised with each change of what is made of the same frames: finished work is then made anew."""


@dataclass(frozen=True)
class _Measure:
    """What the models of one recipe are judged by."""

    usable: dict[Video, int]
    own: OwnMatches

    @staticmethod
    def of(database: Database) -> "_Measure":
        return _Measure(usable_frames(database.feature_counts()), own_matches(database))

    def quality(self, folder: Path) -> Quality:
        model = read_model(folder)
        return judge(model, self.usable, self.own.shares(model))


@dataclass(frozen=True)
class _Attempt:
    rung: Rung
    database: Database
    """The matches it was made from: its pictures' features are numbered there."""
    measure: _Measure
    folder: Path
    quality: Quality


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
    """At most so many rungs of the ladder are tried while the result is not good enough."""
    learned: Path | None = None
    """Folder with aliked-n16rot.onnx and aliked-lightglue.onnx, to match with ALIKED and LightGlue
    instead of SIFT; needs a pycolmap with ONNX. Nothing is ever downloaded."""

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
        if self.learned is not None:
            check_learned(self.learned)
        frames = (*before.frames, *after.frames)
        _refuse_identical(frames)
        files = SfmWorkspace(workspace)
        key = self._fingerprint(frames)
        if not files.is_finished(key):
            files.restart(key)
            files.finish(key, self._register(write_pictures(frames, files), files, progress))
        return self._geometry(frames, read_model(files.sparse), files.record())

    def _fingerprint(self, frames: Sequence[Frame]) -> str:
        """Tells whether finished work in the workspace is of the same frames and options."""
        digest = hashlib.blake2b(digest_size=16)
        rungs = ladder(len(frames), self.learned)[: self.attempts]
        options = (self.max_side, self.seed, rungs, VERSION, _REVISION)
        digest.update(repr(options).encode())
        for frame in frames:
            digest.update(repr((picture_name(frame), frame.image.shape, frame.focal_px)).encode())
            digest.update(frame.image.tobytes())
            if frame.ignore is not None:
                digest.update(np.packbits(frame.ignore).tobytes())
        return digest.hexdigest()

    def _register(
        self, pictures: tuple[Picture, ...], files: SfmWorkspace, progress: Progress
    ) -> Record:
        """Climb the ladder, refine the best attempt, check that its alignment is the only one."""
        attempts, database, log = self._climb(pictures, files, progress)
        features, pairs = database.feature_counts(), database.verified_pairs()
        aligned = [attempt for attempt in attempts if attempt.quality.aligned]
        if not aligned or not has_parallax(pairs):
            reason = failure([attempt.quality for attempt in attempts], features, pairs)
            raise AlignmentError(f"Before and after could not be aligned: {reason}")
        best = max(aligned, key=lambda attempt: attempt.quality.rank)

        measure = best.measure
        folder, outcome = refine(best.folder, files.folder / "refined", lens=len(pictures) > 2)
        if not measure.quality(folder).aligned:
            folder, outcome = best.folder, "Robust adjustment left out."

        apart = files.folder / "apart"
        verdict = check_alignment(best.database, best.rung, apart, measure.usable)
        folder = verdict.model or folder
        folder, late = self._place_leftovers(folder, best.database, files, measure)
        model = read_model(folder)
        shares = measure.own.shares(model)
        quality = judge(model, measure.usable, shares)
        weak = weak_pictures(model)
        posed = {picture.name for picture in model.pictures} - set(weak)
        missing = sorted({picture.name for picture in pictures} - posed)
        return Record(
            str(folder.relative_to(files.folder)),
            (*log, outcome, *verdict.log, *late),
            (*few_points_warning(quality), *verdict.warnings),
            {name: frame_reason(name, features, pairs, weak) for name in missing},
            shares,
        )

    def _climb(
        self, pictures: tuple[Picture, ...], files: SfmWorkspace, progress: Progress
    ) -> tuple[list[_Attempt], Database, list[str]]:
        """Try rung after rung: the models, the last matches, and a line of log a rung."""
        first, *others = ladder(len(pictures), self.learned)[: max(self.attempts, 1)]
        attempts: list[_Attempt] = []
        log: list[str] = []
        measures: dict[str, _Measure] = {}
        for rung in (first, *others):
            recipe = replace(rung.features, max_side=self.max_side)
            database = matched(pictures, recipe, files, self.seed, progress)
            models = database.reconstruct(
                files.folder / rung.name,
                rung.mapper,
                # a mapper that starts anew counts on: never show more frames than there are
                lambda n: progress("camera poses", min(n, len(pictures)), len(pictures)),
            )
            if recipe.name not in measures:
                measures[recipe.name] = _Measure.of(database)
            measure = measures[recipe.name]
            found = [_Attempt(rung, database, measure, m, measure.quality(m)) for m in models]
            outcome = "; ".join(str(attempt.quality) for attempt in found) or "no model"
            log.append(f"{rung.features.name} features, {rung.mapper.name} mapping: {outcome}.")
            if len(found) > 1 and not any(attempt.quality.complete for attempt in found):
                merged = merge(models, database, files.folder / f"{rung.name}-merged")
                joined = [_Attempt(rung, database, measure, m, measure.quality(m)) for m in merged]
                log += [f"Models joined by the matches between them: {a.quality}." for a in joined]
                found += joined
            attempts += found
            if any(attempt.quality.complete for attempt in found):
                break
            if len(measures) > 1 and not has_support(database.verified_pairs()):
                break
        return attempts, database, log

    @staticmethod
    def _place_leftovers(
        folder: Path, database: Database, files: SfmWorkspace, measure: _Measure
    ) -> tuple[Path, tuple[str, ...]]:
        """Place what the model lacks; it stays as it was where that makes it no better."""
        before = measure.quality(folder)
        many = len(database.pictures) > 2
        grown, names = place_leftovers(folder, database, files.folder / "leftovers", lens=many)
        if not names:
            return folder, ()
        after = measure.quality(grown)
        count = f"{len(names)} left-out {'frame' if len(names) == 1 else 'frames'}"
        if after.rank <= before.rank:
            return folder, (f"Placing {count} against the model made it no better.",)
        return grown, (f"Placed {count} against the model: {after}.",)

    def _geometry(self, frames: Sequence[Frame], model: SparseModel, record: Record) -> Geometry:
        """Views in the captures' order; observations renumbered to it."""
        checks = placements(model, record.shares)
        posed = {
            picture.name: number
            for number, picture in enumerate(model.pictures)
            if picture.name not in record.reasons
        }
        views, rank = [], np.full(len(model.pictures), -1)
        for frame in (f for f in frames if picture_name(f) in posed):
            number = posed[picture_name(frame)]
            picture = model.pictures[number]
            rank[number] = len(views)
            lens = resize_lens(picture.lens, frame.width, frame.height)
            view = make_view(frame, lens, picture.cam_from_world, self.long_side)
            views.append(replace(view, placement=checks[number]))
        points, positions = model.points.observations.T
        kept = rank[positions] >= 0
        observations = np.stack([points[kept], rank[positions][kept]], axis=1)
        return Geometry(
            views=tuple(views),
            points=SparsePoints(model.points.xyz, model.points.rgb, observations),
            unregistered=tuple(
                Unregistered(f.video, f.index, record.reasons[picture_name(f)])
                for f in frames
                if picture_name(f) not in posed
            ),
            warnings=(*record.warnings, *low_confidence_warning(views)),
            log=record.log,
            bridge=int(bridging(model).sum()),
        )


def _refuse_identical(frames: Sequence[Frame]) -> None:
    if all(np.array_equal(frames[0].image, frame.image) for frame in frames[1:]):
        raise AlignmentError(
            "Before and after could not be aligned: all frames are the same picture "
            "(no parallax): move the camera around the scene while recording."
        )
