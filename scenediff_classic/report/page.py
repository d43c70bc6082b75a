"""``report.html``: one self-contained page that shows what was found and why."""

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from scenediff_classic.geometry.registration.placement import LOW_CONFIDENCE
from scenediff_classic.report.comparisons import PANELS, ComparisonRow, comparison_rows
from scenediff_classic.report.crops import Crop, crops_of
from scenediff_classic.report.embedded import Picture, embed
from scenediff_classic.report.heatmaps import Scale, ScoreRow, scales, score_rows
from scenediff_classic.report.keyframes import KeyPair, choose_pairs, key_pairs
from scenediff_classic.report.palette import KIND_COLOUR, VIDEO_COLOUR, css, heat_gradient
from scenediff_classic.report.reasons import reasons
from scenediff_classic.report.viewer import scene_json
from scenediff_classic.result import RunInfo, json_ready
from scenediff_classic.types import (
    DOUBTFUL,
    VIDEOS,
    Capture,
    ChangedObject,
    ChangeResult,
    Evidence,
    Placement,
    Video,
    VideoInfo,
)
from scenediff_classic.workspace import write_atomic

_FOLDER = Path(__file__).parent
_PAIRS = 8
"""Pairs of key frames on the page; ``overlays/`` has every frame."""
_SCORED = 12
"""Views whose score maps are on the page."""
_PICTURED = 60
"""Objects with close-ups, the most confident ones: keeps the page under about 15 MB."""

_TIMES = " \N{MULTIPLICATION SIGN} "


@dataclass(frozen=True)
class _Place:
    """An object's close-up and position in one capture."""

    video: Video
    picture: Picture | None
    caption: str
    position: str | None
    size: str | None


@dataclass(frozen=True)
class _Row:
    """An object in the summary table."""

    item: ChangedObject
    places: tuple[_Place, ...]
    views: str
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class _Stage:
    name: str
    seconds: str
    share: float
    """Relative to the longest stage, 0 to 1."""


@dataclass(frozen=True)
class _Lost:
    video: Video
    title: str
    reason: str


@dataclass(frozen=True)
class _Placed:
    """A frame in the strip and the table of how firmly frames are placed."""

    title: str
    placement: Placement
    low: bool


@dataclass(frozen=True)
class _PlacedCapture:
    video: Video
    frames: tuple[_Placed, ...]


@dataclass(frozen=True)
class _Fact:
    name: str
    value: str


@dataclass(frozen=True)
class _Page:
    """Everything the template shows."""

    verdict: str
    remark: str
    sources: tuple[_Fact, ...]
    facts: tuple[_Fact, ...]
    warnings: tuple[str, ...]
    rows: tuple[_Row, ...]
    pairs: tuple[KeyPair, ...]
    scales: tuple[Scale, ...]
    score_rows: tuple[ScoreRow, ...]
    panels: tuple[str, ...]
    comparisons: tuple[ComparisonRow, ...]
    lost: tuple[_Lost, ...]
    placed: tuple[_PlacedCapture, ...]
    low_confidence: float
    log: tuple[str, ...]
    stages: tuple[_Stage, ...]
    versions: tuple[_Fact, ...]
    command: str
    config: str


def write_report(
    result: ChangeResult,
    evidence: Evidence,
    before: Capture,
    after: Capture,
    run: RunInfo,
    path: Path,
) -> None:
    """Write the page; all pictures, styles and scripts are inside the file.

    Parameters
    ----------
    result : ChangeResult
        Positions and sizes in the world frame.
    evidence : Evidence
        Its geometry may be normalised (`Geometry.unit` leads back to the world).
    before, after : Capture
        The frames that `result` speaks of.
    run : RunInfo
        Settings, versions, timings.
    path : Path
        The HTML file.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    html = environment.get_template("template.html").render(
        page=_page(result, evidence, {"before": before, "after": after}, run),
        scene=Markup(scene_json(result, evidence.geometry)),
        style=Markup((_FOLDER / "style.css").read_text(encoding="utf-8")),
        script=Markup((_FOLDER / "viewer.js").read_text(encoding="utf-8")),
        kinds={kind: css(colour) for kind, colour in KIND_COLOUR.items()},
        videos={video: css(colour) for video, colour in VIDEO_COLOUR.items()},
        gradient=Markup(heat_gradient()),
    )
    # File names that are no valid text must not cost the page: they show as question marks.
    write_atomic(path, html.encode("utf-8", "replace"))


def verdict(result: ChangeResult) -> str:
    """The answer in one line, such as "2 objects changed: 1 added, 1 moved"."""
    sure = [item for item in result.objects if not item.doubtful]
    doubtful = len(result.objects) - len(sure)
    if not result.objects:
        return "No change found"
    if not sure:
        return f"{_count(doubtful, 'doubtful change')}, no sure one"
    counts = Counter(item.kind for item in sure)
    parts = ", ".join(f"{counts[kind]} {kind}" for kind in KIND_COLOUR if counts[kind])
    more = f" ({doubtful} more doubtful)" if doubtful else ""
    return f"{_count(len(sure), 'object')} changed: {parts}{more}"


def _page(
    result: ChangeResult, evidence: Evidence, captures: dict[Video, Capture], run: RunInfo
) -> _Page:
    geometry = evidence.geometry
    pairs = choose_pairs(result, evidence, _PAIRS)
    positions = tuple(dict.fromkeys(view for pair in pairs for view in pair))[:_SCORED]
    bars = scales(evidence.scores, result.threshold)
    collected = (*result.warnings, *geometry.warnings)
    collected += tuple(text for video in VIDEOS for text in captures[video].warnings)
    ranked = sorted(result.objects, key=lambda item: (-item.confidence, item.id))
    rows = [_row(item, evidence, captures, i < _PICTURED) for i, item in enumerate(ranked)]
    return _Page(
        verdict=verdict(result),
        remark=_remark(result),
        sources=(_Fact("before", result.before.source), _Fact("after", result.after.source)),
        facts=_facts(result, evidence, run),
        warnings=tuple(dict.fromkeys(collected)),
        rows=tuple(rows),
        pairs=key_pairs(result, evidence, captures, pairs),
        scales=bars,
        score_rows=score_rows(evidence, positions, bars, result.threshold),
        panels=PANELS,
        comparisons=comparison_rows(evidence, positions),
        lost=(*_lost("before", result.before), *_lost("after", result.after)),
        placed=tuple(c for v in VIDEOS if (c := _placed(v, _info(result, v))).frames),
        low_confidence=LOW_CONFIDENCE,
        log=geometry.log,
        stages=_stages(run.stage_seconds or evidence.stage_seconds),
        versions=tuple(_Fact(name, version) for name, version in run.versions.items()),
        command=" ".join(run.command),
        config=json.dumps(json_ready(run.config), indent=2, ensure_ascii=False),
    )


def _remark(result: ChangeResult) -> str:
    if result.threshold is None:
        return "The change scores do not stand out of the noise anywhere."
    if not result.objects:
        return "Some scores pass the threshold, but no region of object size is left."
    text = "Sorted by confidence. Look at the close-ups before you rely on a finding."
    if any(item.doubtful for item in result.objects):
        text += f" Doubtful: a confidence below {DOUBTFUL:.0%}."
    return text


def _facts(result: ChangeResult, evidence: Evidence, run: RunInfo) -> tuple[_Fact, ...]:
    total = sum((run.stage_seconds or evidence.stage_seconds).values())
    threshold = "none" if result.threshold is None else f"{result.threshold:.3f}"
    facts = [
        _Fact("frames located, before", _registered(result.before)),
        _Fact("frames located, after", _registered(result.after)),
        _Fact("view pairs compared", str(len(evidence.pairs))),
        _Fact("score threshold", threshold),
        _Fact("time", _duration(total)),
    ]
    if result.bridge is not None:
        facts.insert(2, _Fact("points seen by both", str(result.bridge)))
    if run.peak_memory_bytes is not None:
        facts.append(_Fact("peak memory", f"{run.peak_memory_bytes / 1e9:.1f} GB"))
    return tuple(facts)


def _registered(info: VideoInfo) -> str:
    return f"{sum(frame.registered for frame in info.frames)} of {len(info.frames)}"


def _row(
    item: ChangedObject, evidence: Evidence, captures: dict[Video, Capture], pictured: bool
) -> _Row:
    crops: dict[Video, Crop | None] = {"before": None, "after": None}
    if pictured:
        crops = crops_of(item, evidence.geometry, captures)
    seen = Counter(view.video for view in item.views)
    views = ", ".join(f"{seen[video]} {video}" for video in VIDEOS if seen[video])
    places = tuple(_place(item, video, crops[video]) for video in VIDEOS)
    return _Row(item, places, views, reasons(item))


def _place(item: ChangedObject, video: Video, crop: Crop | None) -> _Place:
    centre = item.centroid_before if video == "before" else item.centroid_after
    extent = item.extent_before if video == "before" else item.extent_after
    picture, caption = None, "not in view"
    if crop is not None:
        what = "object" if crop.shows_object else "its place"
        caption = ("" if crop.shows_object else "same place, ") + f"frame {crop.frame}"
        picture = embed(crop.image, f"{item.id} {item.kind}: {what} in {video}, frame {crop.frame}")
    return _Place(
        video,
        picture,
        caption,
        None if centre is None else ", ".join(f"{value:.3g}" for value in centre),
        None
        if extent is None
        else " \N{MULTIPLICATION SIGN} ".join(f"{value:.2g}" for value in extent),
    )


def _lost(video: Video, info: VideoInfo) -> tuple[_Lost, ...]:
    return tuple(
        _Lost(video, f"frame {frame.index} · {frame.name}", frame.reason or "no reason recorded")
        for frame in info.frames
        if not frame.registered
    )


def _info(result: ChangeResult, video: Video) -> VideoInfo:
    return result.before if video == "before" else result.after


def _placed(video: Video, info: VideoInfo) -> _PlacedCapture:
    frames = (
        _Placed(
            f"frame {frame.index} · {frame.name}",
            frame.placement,
            frame.placement.confidence < LOW_CONFIDENCE,
        )
        for frame in info.frames
        if frame.placement is not None
    )
    return _PlacedCapture(video, tuple(frames))


def _stages(seconds: Mapping[str, float]) -> tuple[_Stage, ...]:
    longest = max(seconds.values(), default=0.0) or 1.0
    return tuple(_Stage(name, _duration(s), s / longest) for name, s in seconds.items())


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" + ("" if number == 1 else "s")
