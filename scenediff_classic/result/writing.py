"""Writing ``changes.json``."""

import json
from pathlib import Path
from typing import Any

from scenediff_classic.types import (
    ChangedObject,
    ChangeResult,
    Match,
    ObjectView,
    Placement,
    Support,
    VideoInfo,
)
from scenediff_classic.workspace import write_atomic

SCHEMA_VERSION = 1

_DIGITS = 6
"""Significant digits kept: a micrometre in a metre, far below what stereo can measure."""


def write_result(result: ChangeResult, path: Path) -> None:
    """Write ``changes.json``: the same result always gives the same bytes.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    document = {
        "schema": SCHEMA_VERSION,
        "videos": {"before": _video_json(result.before), "after": _video_json(result.after)},
        "objects": [_object_json(item) for item in result.objects],
        "threshold": None if result.threshold is None else _rounded(result.threshold),
        "scale": _rounded(result.scale),
        "warnings": list(result.warnings),
        "bridge": None if result.bridge is None else int(result.bridge),
    }
    # Escaped to ASCII, because file names need not be valid Unicode.
    text = json.dumps(document, indent=1, allow_nan=False)
    write_atomic(path, text + "\n")


def _rounded(value: float) -> float:
    return float(f"{float(value):.{_DIGITS}g}")


def _vector_json(vector: tuple[float, ...] | None) -> list[float] | None:
    return None if vector is None else [_rounded(value) for value in vector]


def _video_json(video: VideoInfo) -> dict[str, Any]:
    frames = [
        {
            "index": int(frame.index),
            "name": frame.name,
            # Microseconds: a time stamp must not lose digits in a long video.
            "time_s": None if frame.time_s is None else round(float(frame.time_s), 6),
            "width": int(frame.width),
            "height": int(frame.height),
            "registered": bool(frame.registered),
            "reason": frame.reason,
            "placement": frame.placement and _placement_json(frame.placement),
        }
        for frame in video.frames
    ]
    return {"source": video.source, "frames": frames}


def _placement_json(placement: Placement) -> dict[str, Any]:
    return {
        "confidence": _rounded(placement.confidence),
        "points": int(placement.points),
        "shared": int(placement.shared),
        "cover": _rounded(placement.cover),
        "error_px": _rounded(placement.error_px),
        "agreement": None if placement.agreement is None else _rounded(placement.agreement),
    }


def _object_json(item: ChangedObject) -> dict[str, Any]:
    return {
        "id": int(item.id),
        "kind": item.kind,
        "confidence": _rounded(item.confidence),
        "centroid_before": _vector_json(item.centroid_before),
        "centroid_after": _vector_json(item.centroid_after),
        "extent_before": _vector_json(item.extent_before),
        "extent_after": _vector_json(item.extent_after),
        "scores": {
            "geometry": _rounded(item.scores.geometry),
            "feature": _rounded(item.scores.feature),
            "region": _rounded(item.scores.region),
        },
        "support": item.support and _support_json(item.support),
        "match": item.match and _match_json(item.match),
        "views": [_view_json(view) for view in item.views],
    }


def _support_json(support: Support) -> dict[str, Any]:
    return {
        "compared": int(support.compared),
        "above": int(support.above),
        "strongest": [
            {
                "video": pair.video,
                "frame": int(pair.frame),
                "other": int(pair.other),
                "score": _rounded(pair.score),
            }
            for pair in support.strongest
        ],
    }


def _match_json(match: Match) -> dict[str, float]:
    return {
        "similarity": _rounded(match.similarity),
        "least": _rounded(match.least),
        "size_ratio": _rounded(match.size_ratio),
        "most": _rounded(match.most),
    }


def _view_json(view: ObjectView) -> dict[str, Any]:
    return {
        "video": view.video,
        "frame": int(view.frame),
        "confidence": _rounded(view.confidence),
        "bbox": [_rounded(value) for value in view.bbox],
        "rle": {"size": [int(side) for side in view.mask.size], "counts": view.mask.counts},
    }
