"""A finished run in the formats that other tools read."""

import json
import pickle
from pathlib import Path
from typing import Any, Literal, get_args

from scenediff_classic import masks
from scenediff_classic.dataset.predictions import (
    PUBLISHED_KEYS,
    PredictedObject,
    Prediction,
    read_prediction,
)
from scenediff_classic.errors import InputError
from scenediff_classic.types import VIDEOS, Kind, Video
from scenediff_classic.workspace import write_atomic

ExportFormat = Literal["scenediff", "coco"]

DEFAULT_NAMES: dict[ExportFormat, str] = {"scenediff": "object_masks.pkl", "coco": "coco.json"}
KINDS: tuple[Kind, ...] = get_args(Kind)
CAPTURES: dict[Kind, tuple[Video, ...]] = {
    "removed": ("before",),
    "added": ("after",),
    "moved": VIDEOS,
}


def export(out_dir: Path, format: ExportFormat, destination: Path | None = None) -> Path:
    """Write a run's objects in another format.

    Parameters
    ----------
    out_dir : Path
        Output folder of a finished run (it holds ``changes.json``).
    format : {"scenediff", "coco"}
        The SceneDiff Benchmark's ``object_masks.pkl``, or COCO JSON.
    destination : Path, optional
        The file to write, or a folder for it; the run's own folder if omitted.

    Returns
    -------
    Path
        The file that was written.

    Raises
    ------
    InputError
        `out_dir` holds no readable result, or the format is not known.
    OutputError
        The file cannot be written.
    """
    source = out_dir / "changes.json"
    if not source.is_file():
        raise InputError(f"{out_dir} holds no changes.json: give the folder of a finished run.")
    if format not in DEFAULT_NAMES:
        raise InputError(f"'{format}' is no export format: choose scenediff or coco.")
    target = out_dir if destination is None else destination
    if target.is_dir():
        target = target / DEFAULT_NAMES[format]
    prediction = read_prediction(source)
    write = write_object_masks if format == "scenediff" else write_coco
    write(prediction, target)
    return target


def write_object_masks(prediction: Prediction, path: Path) -> None:
    """Write the published layout: object -> capture -> sampled frame -> mask and confidence.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    content: dict[Any, Any] = {}
    if prediction.size is not None:
        content["H"], content["W"] = prediction.size
    for item in prediction.objects:
        content[item.id] = {PUBLISHED_KEYS[v]: _frames(item, v) for v in CAPTURES[item.kind]}
    write_atomic(path, pickle.dumps(content, protocol=4))


def _frames(item: PredictedObject, video: Video) -> dict[int, Any]:
    return {
        view.frame: {
            "mask": {"size": list(view.mask.size), "counts": view.mask.counts.encode("ascii")},
            "mask_size": masks.area(view.mask),
            "cost": view.confidence,
        }
        for view in item.views
        if view.video == video
    }


def write_coco(prediction: Prediction, path: Path) -> None:
    """Write COCO JSON: an image per sampled frame, an annotation per object and frame.

    Categories are the change types. ``object_id`` (beyond COCO's own keys) joins the annotations
    of one object, ``score`` is the confidence, ``video`` and ``frame`` name the sampled frame.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    image_ids = {(p.video, p.index): i for i, p in enumerate(prediction.pictures, start=1)}
    images = [
        {
            "id": image_ids[p.video, p.index],
            "file_name": p.name,
            "height": p.height,
            "width": p.width,
            "video": p.video,
            "frame": p.index,
        }
        for p in prediction.pictures
    ]
    content = {
        "info": {"description": "Changed objects between two captures of a scene"},
        "images": images,
        "categories": [{"id": i, "name": kind} for i, kind in enumerate(KINDS, start=1)],
        "annotations": _annotations(prediction, image_ids, path),
    }
    text = json.dumps(content, ensure_ascii=False, indent=1)
    write_atomic(path, text + "\n")


def _annotations(
    prediction: Prediction, image_ids: dict[Any, Any], path: Path
) -> list[dict[str, Any]]:
    annotations: list[dict[str, Any]] = []
    for item in prediction.objects:
        for view in item.views:
            if (view.video, view.frame) not in image_ids:
                raise InputError(
                    f"{path} was not written: object {item.id} has a mask in {view.video} frame "
                    f"{view.frame}, which is not among the run's frames."
                )
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": image_ids[view.video, view.frame],
                    "category_id": KINDS.index(item.kind) + 1,
                    "object_id": item.id,
                    "score": view.confidence,
                    "segmentation": {"size": list(view.mask.size), "counts": view.mask.counts},
                    "area": masks.area(view.mask),
                    "bbox": list(masks.bbox(view.mask)),
                    "iscrowd": 0,
                }
            )
    return annotations
