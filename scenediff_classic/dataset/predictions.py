"""What a method answered for a pair, from ``changes.json`` or from ``object_masks.pkl``."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from scenediff_classic.dataset import records
from scenediff_classic.dataset.pickles import read_pickle
from scenediff_classic.errors import InputError
from scenediff_classic.types import VIDEOS, Kind, Rle, Video

PUBLISHED_KEYS: dict[Video, str] = {"before": "video_1", "after": "video_2"}
"""Names of the captures in the published layout."""


@dataclass(frozen=True)
class PredictedView:
    """A predicted object in one frame."""

    video: Video
    frame: int
    """Index among the sampled frames."""
    confidence: float
    mask: Rle


@dataclass(frozen=True)
class PredictedObject:
    """A predicted object over all frames; it may have no view at all."""

    id: int | str
    kind: Kind
    views: tuple[PredictedView, ...]
    """Views in the before capture first, each capture in the file's order."""


@dataclass(frozen=True)
class Picture:
    """A sampled frame, by name and input size."""

    video: Video
    index: int
    name: str
    height: int
    width: int


@dataclass(frozen=True)
class Prediction:
    """All objects that a method reported for a pair."""

    objects: tuple[PredictedObject, ...]
    size: tuple[int, int] | None = None
    """(height, width) that the file states for its masks."""
    pictures: tuple[Picture, ...] = ()
    """The sampled frames; empty when read from the published layout, which lacks them."""


def find_prediction(folder: Path) -> Path | None:
    """The prediction file in a folder: ``changes.json``, else ``object_masks.pkl``, else None."""
    names = ("changes.json", "object_masks.pkl")
    return next((folder / name for name in names if (folder / name).is_file()), None)


def read_prediction(path: Path) -> Prediction:
    """Read ``changes.json`` or ``object_masks.pkl``, told apart by suffix.

    Raises
    ------
    InputError
        The file is malformed, or nests captures over objects instead of objects over captures.
    """
    if path.suffix == ".pkl":
        return _from_published(records.mapping(read_pickle(path), str(path)), str(path))
    return _from_changes(records.mapping(records.read_json(path), str(path)), str(path))


def _from_changes(content: dict[Any, Any], where: str) -> Prediction:
    if content.get("schema") != 1:
        raise InputError(f"{where}: 'schema' should be 1; the file is of another version.")
    pictures = tuple(_pictures(content.get("videos", {}), f"{where}: videos"))
    items = records.sequence(records.entry(content, "objects", where), f"{where}: 'objects'")
    objects = tuple(_changed_object(v, f"{where}: objects[{i}]") for i, v in enumerate(items))
    size = (pictures[0].height, pictures[0].width) if pictures else None
    return Prediction(objects, size, pictures)


def _pictures(value: object, where: str) -> Iterator[Picture]:
    videos = records.mapping(value, where)
    for video in VIDEOS:
        place = f"{where}.{video}"
        frames = records.mapping(videos.get(video, {}), place).get("frames", [])
        for i, frame in enumerate(records.sequence(frames, f"{place}.frames")):
            at = f"{place}.frames[{i}]"
            record = records.mapping(frame, at)
            yield Picture(
                video,
                records.index(records.entry(record, "index", at), f"{at}.index"),
                records.text(records.entry(record, "name", at), f"{at}.name"),
                records.index(records.entry(record, "height", at), f"{at}.height", lowest=1),
                records.index(records.entry(record, "width", at), f"{at}.width", lowest=1),
            )


def _changed_object(value: object, where: str) -> PredictedObject:
    record = records.mapping(value, where)
    kind = _choice(records.entry(record, "kind", where), get_args(Kind), f"{where}.kind")
    items = records.sequence(records.entry(record, "views", where), f"{where}.views")
    views = [_changed_view(v, f"{where}.views[{i}]") for i, v in enumerate(items)]
    absent = {"removed": "after", "added": "before"}.get(kind)
    if any(view.video == absent for view in views):
        raise InputError(f"{where} is '{kind}' but has a mask in the {absent} capture.")
    if len({(view.video, view.frame) for view in views}) < len(views):
        raise InputError(f"{where} has two masks in one frame.")
    number = records.index(records.entry(record, "id", where), f"{where}.id")
    return PredictedObject(number, kind, tuple(sorted(views, key=lambda v: VIDEOS.index(v.video))))


def _changed_view(value: object, where: str) -> PredictedView:
    record = records.mapping(value, where)
    return PredictedView(
        _choice(records.entry(record, "video", where), VIDEOS, f"{where}.video"),
        records.index(records.entry(record, "frame", where), f"{where}.frame"),
        records.number(records.entry(record, "confidence", where), f"{where}.confidence"),
        records.mask(records.entry(record, "rle", where), f"{where}.rle"),
    )


def _choice(value: object, choices: tuple[Any, ...], where: str) -> Any:
    if not isinstance(value, str) or value not in choices:
        raise InputError(f"{where} should be one of {', '.join(choices)}.")
    return value


def _from_published(content: dict[Any, Any], where: str) -> Prediction:
    size = None
    if "H" in content and "W" in content:
        height = records.index(content["H"], f"{where}: 'H'", lowest=1)
        size = height, records.index(content["W"], f"{where}: 'W'", lowest=1)
    by_object = {key: value for key, value in content.items() if key not in ("H", "W")}
    if by_object and set(by_object) <= set(PUBLISHED_KEYS.values()):
        raise InputError(
            f"{where} nests video -> object -> frame, as the benchmark's README shows it; the "
            "published evaluator reads object -> video -> frame, and would score this file 0. "
            "Write each object's number at the top, and 'video_1' and 'video_2' below it."
        )
    objects = (
        _published_object(key, value, f"{where}: object {records.shown(key)}")
        for key, value in by_object.items()
    )
    return Prediction(tuple(item for item in objects if item is not None), size)


def _published_object(key: object, value: object, where: str) -> PredictedObject | None:
    """One object of the published layout, or None for one that names no capture at all."""
    record = records.mapping(value, where)
    present: list[Video] = [video for video in VIDEOS if PUBLISHED_KEYS[video] in record]
    if not present:  # the published evaluator drops these as well
        return None
    kind: Kind = "moved" if len(present) == 2 else "removed" if "before" in present else "added"
    views = [
        _published_view(video, frame, item, f"{where}, {PUBLISHED_KEYS[video]}")
        for video in present
        for frame, item in records.mapping(record[PUBLISHED_KEYS[video]], where).items()
    ]
    name = key if isinstance(key, int) else records.text(key, f"{where}: its name")
    return PredictedObject(name, kind, tuple(views))


def _published_view(video: Video, frame: object, value: object, where: str) -> PredictedView:
    where = f"{where}, frame {records.shown(frame)}"
    record = records.mapping(value, where)
    return PredictedView(
        video,
        records.index(frame, f"{where}: its index"),
        records.number(records.entry(record, "cost", where), f"{where}: 'cost'"),
        records.mask(records.entry(record, "mask", where), where),
    )
