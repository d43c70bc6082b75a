"""Joint structure from motion over both captures: cameras without any prior knowledge.

The classical stand-in for the feed-forward geometry model of the paper (Sec. 4.1). Both captures
go into one reconstruction, because two separate ones would share neither scale nor frame.
"""

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from scenediff_classic.errors import AlignmentError, OutputError
from scenediff_classic.geometry import colmap
from scenediff_classic.geometry.colmap import Database, read_model, write_model
from scenediff_classic.geometry.laying_over import (
    AMBIGUOUS,
    Laying,
    ground_share,
    laid_over,
    layings,
    looks_of,
)
from scenediff_classic.geometry.pairing import matching_pairs
from scenediff_classic.geometry.registration import (
    FEW_BRIDGE,
    LOW_CONFIDENCE,
    Quality,
    bridging,
    failure,
    frame_reason,
    has_parallax,
    judge,
    placements,
    usable_frames,
    video_of,
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
    View,
)

_REVISION = 2
"""Counts changes of what is made of a reconstruction, so that no older one is reused."""
OWN_FRAMES = 0.8
"""Share of a capture's frames that must hang together by themselves to judge the joint model."""
_NAMED = 12
"""Most frames that a warning names."""


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
        """
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
        options = (self.max_side, self.seed, self.attempts, LADDER, colmap.VERSION, _REVISION)
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
        tried: list[tuple[Quality, Path]] = []
        log: list[str] = []
        database: Database | None = None
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
        pairs = matching_pairs(captures, database, self.seed)
        for start in range(0, len(pairs), 200):
            progress("matching", start, len(pairs))
            database.match(pairs[start : start + 200], recipe)
        progress("matching", len(pairs), len(pairs))
        os.replace(path, final)
        return Database(final, files.images, pictures, self.seed)

    def _geometry(self, frames: Sequence[Frame], model: SparseModel, record: Record) -> Geometry:
        """Views in the captures' order; observations renumbered to it."""
        checks = placements(model)
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
            view = make_view(frame, lens, picture.cam_from_world, self.long_side)
            views.append(replace(view, placement=checks[posed[picture.name]]))
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
            warnings=(*record.warnings, *_doubtful(views)),
            log=record.log,
            bridge=int(bridging(model).sum()),
        )


def _conclude(
    tried: Sequence[tuple[Quality, Path]],
    database: Database,
    files: SfmWorkspace,
    log: Sequence[str],
) -> Record:
    """The best attempt, or the error that explains why there is none."""
    features, pairs = database.feature_counts(), database.verified_pairs()
    aligned = [(quality, folder) for quality, folder in tried if quality.aligned]
    log = list(log)
    if not aligned or not has_parallax(pairs):
        reason = failure([quality for quality, _ in tried], features, pairs)
        raise AlignmentError(f"Before and after could not be aligned: {reason}")
    quality, folder = max(aligned, key=lambda attempt: attempt[0].rank)
    warnings = []
    if quality.bridge < FEW_BRIDGE:
        warnings.append(
            f"Before and after hang together by only {quality.bridge} points: "
            "their alignment may be inaccurate."
        )
    found = _layings(database, folder, files)
    if found.ways:
        shares = f"{len(found.ways[0].pairs)} points agree on the alignment"
        if len(found.ways) > 1:
            shares += f", {len(found.ways[1].pairs)} on one other motion ({found.share:.0%})"
        log.append(f"Captures reconstructed apart and laid over each other: {shares}.")
    if found.share >= AMBIGUOUS:
        warning = (
            "The alignment of before and after is ambiguous: much of the scene moved by one and "
            f"the same motion ({found.share:.0%} of what both captures show, or all but that), and "
            "what is reported as moved may be what stayed."
        )
        chosen = laid_over(found.before, found.after, found.ways[0])
        apart = judge(chosen, quality.total)
        if apart.aligned:  # the joint model may have taken its matches from both, and bent
            folder = files.folder / "laid-over"
            write_model(chosen, folder)
            log.append(f"The captures' own models replace the joint one: {apart}.")
            warning += " What lies farther away was taken for what stayed."
        warnings.append(warning)
    model = read_model(folder)
    weak = weak_pictures(model)
    posed = {picture.name for picture in model.pictures} - set(weak)
    missing = {picture.name for picture in database.pictures} - posed
    return Record(
        str(folder.relative_to(files.folder)),
        tuple(log),
        tuple(warnings),
        {name: frame_reason(name, features, pairs, weak) for name in sorted(missing)},
    )


@dataclass(frozen=True)
class _Layings:
    """The captures' own models, and the ways to lay them over each other."""

    before: SparseModel
    after: SparseModel
    ways: Sequence[Laying]

    @property
    def share(self) -> float:
        return ground_share(tuple(self.ways))


def _layings(database: Database, folder: Path, files: SfmWorkspace) -> _Layings:
    """Reconstruct each capture alone from the same matches, as leniently as the joint model."""
    rung = next((r for r in LADDER if r.name == folder.parent.name), None)
    names = {v: [p.name for p in database.pictures if video_of(p.name) == v] for v in VIDEOS}
    empty = SparseModel((), SparsePoints.none(), float("nan"))
    own = dict.fromkeys(VIDEOS, empty)
    if rung is None or rung.mapper.method == "global" or min(map(len, names.values())) < 3:
        return _Layings(empty, empty, ())
    for video in VIDEOS:
        target = files.folder / f"{rung.name}-{video}"
        models = database.reconstruct(target, rung.mapper, lambda n: None, names[video])
        if models:
            own[video] = read_model(models[0])
        if len(own[video].pictures) < OWN_FRAMES * len(names[video]):
            return _Layings(empty, empty, ())
    before, after = own["before"], own["after"]
    looks = looks_of(before, database.descriptors), looks_of(after, database.descriptors)
    return _Layings(before, after, layings(before, after, *looks, database.seed))


def _doubtful(views: Sequence[View]) -> tuple[str, ...]:
    """One sentence that names the frames whose cameras little holds; none if there are none."""
    low = [v for v in views if v.placement and v.placement.confidence < LOW_CONFIDENCE]
    if not low:
        return ()
    names = [f"{v.video} {v.index} ({v.placement.confidence:.2f})" for v in low if v.placement]
    listed = ", ".join(names[:_NAMED]) + (" and more" if len(names) > _NAMED else "")
    noun = "frame was" if len(low) == 1 else "frames were"
    return (
        f"{len(low)} {noun} placed with low confidence, and what is reported there may be "
        f"misplaced: {listed}.",
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
