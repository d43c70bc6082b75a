"""The truth of a pair: which objects changed, and their masks over the sampled frames.

The same content has two forms on disk: ``segments.json`` (ours: safe to read) and
``segments.pkl`` (the SceneDiff Benchmark's).
"""

import json
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenediff_classic.dataset import records
from scenediff_classic.dataset.pickles import read_pickle
from scenediff_classic.errors import InputError
from scenediff_classic.types import VIDEOS, Kind, Rle, Video
from scenediff_classic.workspace import write_atomic

SAMPLE_STEP = 30
"""Annotations count frames at 30 a second: sampled frame k (one a second) is index 30 k."""
SCHEMA = 1
MASKS_KEYS: dict[Video, str] = {"before": "video1_objects", "after": "video2_objects"}
NUMBERS: dict[Video, int] = {"before": 1, "after": 2}


@dataclass(frozen=True)
class AnnotatedMask:
    """An object's visible pixels in one frame."""

    frame: int
    """Index at 30 frames a second (see `SAMPLE_STEP`)."""
    mask: Rle


@dataclass(frozen=True)
class Track:
    """All masks of one object in one capture, in the file's order."""

    video: Video
    object_id: int
    masks: tuple[AnnotatedMask, ...]


@dataclass(frozen=True)
class AnnotatedObject:
    """One object that an annotator named; its masks are the tracks with its id."""

    object_id: int
    label: str
    """Name and number, as ``mug_1``."""
    in_before: bool
    in_after: bool
    deformability: str | None = None
    frame_before: int | None = None
    """Frame in which the annotator marked the object, or None (-1 in a file)."""
    frame_after: int | None = None
    status_before: str | None = None
    status_after: str | None = None

    @property
    def kind(self) -> Kind | None:
        """Change type, which the flags decide; None for an object in neither capture."""
        if self.in_before and self.in_after:
            return "moved"
        if self.in_before:
            return "removed"
        return "added" if self.in_after else None

    def present(self, video: Video) -> bool:
        """Whether the object is flagged as present in the capture."""
        return self.in_before if video == "before" else self.in_after


@dataclass(frozen=True)
class AnnotatedPair:
    """The truth of one pair of captures."""

    scene_type: str
    tracks: tuple[Track, ...]
    """In the file's order, which the published evaluator's grid depends on; before first."""
    objects: tuple[AnnotatedObject, ...]

    def track(self, video: Video, object_id: int) -> Track | None:
        """The masks of one object in one capture."""
        same = (t for t in self.tracks if t.video == video and t.object_id == object_id)
        return next(same, None)


def read_annotations(path: Path) -> AnnotatedPair:
    """Read ``segments.json`` or ``segments.pkl``.

    Parameters
    ----------
    path : Path
        The file, or the folder that holds it (the JSON form is preferred).

    Raises
    ------
    InputError
        No such file, or its content is malformed; the message names the place.
    """
    if path.is_dir():
        path = next((p for p in annotation_files(path) if p.is_file()), path / "segments.json")
    where = str(path)
    document = read_pickle(path) if path.suffix == ".pkl" else records.read_json(path)
    content = records.mapping(document, where)
    if path.suffix != ".pkl" and content.get("schema") != SCHEMA:
        raise InputError(f"{where}: 'schema' should be {SCHEMA}; the file is of another version.")
    tracks = [track for video in VIDEOS for track in _tracks(content, video, where)]
    objects = records.sequence(records.entry(content, "objects", where), f"{where}: 'objects'")
    return AnnotatedPair(
        scene_type=records.text(content.get("scene_type") or "", f"{where}: 'scene_type'"),
        tracks=tuple(tracks),
        objects=tuple(_object(item, f"{where}: objects[{i}]") for i, item in enumerate(objects)),
    )


def annotation_files(folder: Path) -> tuple[Path, Path]:
    """The two names under which a pair's truth may lie, the preferred one first."""
    return folder / "segments.json", folder / "segments.pkl"


def write_annotations(pair: AnnotatedPair, folder: Path) -> None:
    """Write both ``segments.json`` and ``segments.pkl`` into `folder`.

    Raises
    ------
    OutputError
        The files cannot be written.
    """
    readable, published = annotation_files(folder)
    text = json.dumps({"schema": SCHEMA, **_document(pair, key=str)}, ensure_ascii=False, indent=1)
    write_atomic(readable, text + "\n")
    content = {**_document(pair, key=int), "comments": {}}
    write_atomic(published, pickle.dumps(content, protocol=4))


def _tracks(content: dict[Any, Any], video: Video, where: str) -> list[Track]:
    name = MASKS_KEYS[video]
    by_object = records.mapping(records.entry(content, name, where), f"{where}: '{name}'")
    tracks = []
    for key, frames in by_object.items():
        place = f"{where}: {name}[{records.shown(key)}]"
        found = tuple(
            AnnotatedMask(
                records.index(frame, f"{place}: a frame's index"),
                records.mask(record, f"{place}, frame {frame}"),
            )
            for frame, record in records.mapping(frames, place).items()
        )
        tracks.append(Track(video, records.index(key, f"{place}: the object's number"), found))
    _refuse_repeats([t.object_id for t in tracks], f"{where}: '{name}' has an object")
    for track in tracks:
        named = [m.frame for m in track.masks]
        _refuse_repeats(named, f"{where}: {name}[{track.object_id}] has a frame")
    return tracks


def _refuse_repeats(values: list[int], what: str) -> None:
    if len(set(values)) < len(values):
        raise InputError(f"{what} twice.")


def _object(item: object, where: str) -> AnnotatedObject:
    record = records.mapping(item, where)

    def text(key: str) -> str | None:
        value = record.get(key)
        return None if value is None else records.text(value, f"{where}.{key}")

    def frame(key: str) -> int | None:
        value = record.get(key)
        found = -1 if value is None else records.index(value, f"{where}.{key}", lowest=-1)
        return None if found < 0 else found

    place = f"{where}.original_obj_idx"
    return AnnotatedObject(
        object_id=records.index(records.entry(record, "original_obj_idx", where), place),
        label=text("label") or "",
        in_before=records.flag(record.get("in_video1", False), f"{where}.in_video1"),
        in_after=records.flag(record.get("in_video2", False), f"{where}.in_video2"),
        deformability=text("deformability"),
        frame_before=frame("video1_frame_idx"),
        frame_after=frame("video2_frame_idx"),
        status_before=text("video1_status"),
        status_after=text("video2_status"),
    )


def _document(pair: AnnotatedPair, key: type[int] | type[str]) -> dict[str, Any]:
    by_video: dict[str, Any] = {name: {} for name in MASKS_KEYS.values()}
    for track in pair.tracks:
        by_video[MASKS_KEYS[track.video]][key(track.object_id)] = {
            str(m.frame): {"size": list(m.mask.size), "counts": m.mask.counts} for m in track.masks
        }
    objects = [_object_record(item) for item in pair.objects]
    return {"scene_type": pair.scene_type, **by_video, "objects": objects}


def _object_record(item: AnnotatedObject) -> dict[str, Any]:
    return {
        "label": item.label,
        "in_video1": item.in_before,
        "in_video2": item.in_after,
        "video1_frame_idx": -1 if item.frame_before is None else item.frame_before,
        "video2_frame_idx": -1 if item.frame_after is None else item.frame_after,
        "video1_status": item.status_before,
        "video2_status": item.status_after,
        "original_obj_idx": item.object_id,
        "deformability": item.deformability,
    }
