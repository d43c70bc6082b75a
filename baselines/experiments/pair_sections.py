"""What the page shows of one pair, and the same as files for papers."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np
from jaxtyping import UInt8
from matplotlib.figure import Figure
from PIL import Image, ImageDraw, ImageFont

from baselines.experiments.finished import FinishedRun
from baselines.experiments.pair_pictures import (
    Answer,
    PairPictures,
    answer_picture,
    key_frames,
    said,
    truth_picture,
)
from baselines.experiments.space import first_geometry, plan_of, scene_of
from baselines.experiments.truths import Spot
from scenediff_classic.errors import SceneDiffError
from scenediff_classic.report.embedded import Picture, embed, fit, jpeg
from scenediff_classic.report.heatmaps import ScoreRow, scales, score_row
from scenediff_classic.report.viewer import script_json
from scenediff_classic.result.score_maps import read_scores
from scenediff_classic.types import Geometry, ScoreMaps
from scenediff_classic.workspace import write_atomic

_EACH = 2
"""Key frames of a capture, at most."""


@dataclass(frozen=True)
class Shot:
    """A picture in the grid; leads to a larger one."""

    picture: Picture | None
    href: str | None


@dataclass(frozen=True)
class GridRow:
    """One frame: the truth, then every answer."""

    title: str
    shots: tuple[Shot, ...]


@dataclass(frozen=True)
class Said:
    """One answer in words."""

    title: str
    text: str
    report: str | None
    """Link to the method's own page of the pair."""


@dataclass(frozen=True)
class PairSection:
    """A pair on the page."""

    anchor: str
    name: str
    group: str
    titles: tuple[str, ...]
    """Of the columns of the grid."""
    rows: tuple[GridRow, ...]
    answers: tuple[Said, ...]
    strips: tuple[ScoreRow, ...]
    strip_of: str
    """Whose score maps they are."""
    scene: str | None
    """For the 3D view, as JSON."""
    plan: Figure | None
    plan_of: str
    problem: str = ""
    """Why there are no pictures."""


def link(run: FinishedRun, path: Path) -> str:
    """A path inside the run, from the page."""
    return quote(path.relative_to(run.folder).as_posix())


def report_link(run: FinishedRun, answer: Answer) -> str | None:
    """The method's own page of a pair."""
    return None if answer.report is None else link(run, answer.report)


def pair_section(run: FinishedRun, pictures: PairPictures, anchor: str) -> PairSection:
    """Everything of a pair; writes nothing."""
    spots = key_frames(pictures, _EACH)
    rows = []
    for video, index in spots:
        spot = (video, index)
        truth = truth_picture(pictures, spot)
        name = f"{pictures.name}, {video}, frame {index}"
        shots = [Shot(None if truth is None else embed(truth, f"{name}: truth"), None)]
        for answer in pictures.answers:
            told = answer_picture(pictures, answer, spot) if answer.result else None
            large = _overlay(run, answer, f"{video}_{index:05d}.jpg")
            alt = f"{name}: {answer.title}"
            shots.append(Shot(None if told is None else embed(told, alt), large))
        rows.append(GridRow(f"{video} · frame {index}", tuple(shots)))
    placed = first_geometry(pictures)
    scene = None if placed is None else scene_of(pictures, *placed)
    strips, whose = _strips(pictures, spots, None if placed is None else placed[1])
    return PairSection(
        anchor, pictures.name, pictures.pair.group,
        ("truth" if pictures.truth is not None else "frame", *(a.title for a in pictures.answers)),
        tuple(rows),
        tuple(Said(a.title, said(pictures, a), report_link(run, a)) for a in pictures.answers),
        strips, whose, None if scene is None else script_json(scene),
        None if placed is None else plan_of(*placed), "" if placed is None else placed[0].title,
    )  # fmt: skip


def _overlay(run: FinishedRun, answer: Answer, name: str) -> str | None:
    path = answer.cell.output / "overlays" / name if answer.cell.output else None
    return link(run, path) if path is not None and path.is_file() else None


def _strips(
    pictures: PairPictures, spots: Sequence[Spot], geometry: Geometry | None
) -> tuple[tuple[ScoreRow, ...], str]:
    """Score maps of the first key frame of each capture, of the first answer that has any."""
    if geometry is None:
        return (), ""
    views = {view.key: view for view in geometry.views}
    firsts = [
        s for i, s in enumerate(spots) if s in views and s[0] not in [t[0] for t in spots[:i]]
    ]
    for answer in pictures.answers:
        if answer.result is None or answer.cell.output is None:
            continue
        try:
            folder = answer.cell.output / "scores"
            maps: list[ScoreMaps] = [read_scores(folder, *spot) for spot in firsts]
        except SceneDiffError:
            continue
        if any(m.total.shape != views[s].shape for m, s in zip(maps, firsts, strict=True)):
            continue
        threshold = answer.result.threshold
        bars = scales(tuple(maps), threshold)
        rows = [
            score_row(views[spot], m, bars, threshold) for spot, m in zip(firsts, maps, strict=True)
        ]
        return tuple(rows), answer.title
    return (), ""


def write_grid(pictures: PairPictures, path: Path) -> Path:
    """The grid of a pair as one picture: a row a key frame; truth first, then every answer."""
    rows: list[list[UInt8[np.ndarray, "h w 3"] | None]] = []
    for spot in key_frames(pictures, _EACH):
        told = [
            answer_picture(pictures, answer, spot) if answer.result else None
            for answer in pictures.answers
        ]
        rows.append([truth_picture(pictures, spot), *told])
    titles = ["truth", *(answer.title for answer in pictures.answers)]
    write_atomic(path, jpeg(_composed(rows, titles), 90))
    return path


def _composed(
    rows: Sequence[Sequence[UInt8[np.ndarray, "h w 3"] | None]], titles: Sequence[str]
) -> UInt8[np.ndarray, "h w 3"]:
    gap, head = 6, 26
    first = next(
        (p for row in rows for p in row if p is not None), np.zeros((240, 320, 3), np.uint8)
    )
    height, width = first.shape[:2]
    canvas = Image.new(
        "RGB",
        (len(titles) * (width + gap) - gap, head + len(rows) * (height + gap) - gap),
        (255, 255, 255),
    )
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(17)
    for column, title in enumerate(titles):
        left = column * (width + gap)
        draw.text((left + width / 2, head / 2), title, (20, 20, 24), font, anchor="mm")
        for number, row in enumerate(rows):
            top, picture = head + number * (height + gap), row[column]
            if picture is None:
                draw.rectangle((left, top, left + width - 1, top + height - 1), (235, 235, 235))
                middle = (left + width / 2, top + height / 2)
                draw.text(middle, "failed", (90, 90, 90), font, anchor="mm")
            else:
                canvas.paste(Image.fromarray(fit(picture, max(width, height))), (left, top))
    return np.asarray(canvas)
