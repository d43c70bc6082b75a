"""Truth and answers of a pair painted into the frames that see most change."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from baselines.experiments.finished import Cell, FinishedRun
from baselines.experiments.truths import (
    Grid,
    Spot,
    Thing,
    gridded,
    matches,
    overlaps,
    reported_things,
    true_things,
)
from data_tools.benchmarks.benchmark import BenchmarkPair
from scenediff_classic.errors import SceneDiffError
from scenediff_classic.protocols import silent
from scenediff_classic.report.drawing import Mark, draw_marks, mask_at, outline
from scenediff_classic.report.embedded import fit
from scenediff_classic.report.palette import Colour
from scenediff_classic.result import read_result
from scenediff_classic.types import VIDEOS, Capture, ChangeResult, Video

LONG_SIDE = 320
"""Longer side of the pictures in grids, in pixels."""
_LETTERS = 16.0
"""Labels stay legible where six pictures stand side by side."""
IDENTITY: tuple[Colour, ...] = (
    (255, 176, 0), (86, 180, 233), (0, 200, 140), (240, 228, 66), (224, 130, 190), (250, 110, 60),
    (160, 150, 255), (170, 220, 90),
)  # fmt: skip
"""Colours of true objects, told apart with any kind of colour vision as far as eight go."""
FALSE: Colour = (235, 235, 240)
"""Colour of what was reported though nothing changed there."""


@dataclass(frozen=True)
class Answer:
    """What one method said of a pair."""

    title: str
    cell: Cell
    result: ChangeResult | None
    """None where it failed, or its file is gone."""
    things: tuple[Thing, ...] = ()
    found: Mapping[int, int] = field(default_factory=dict)
    """Position among `things` -> position among the true ones."""

    @property
    def report(self) -> Path | None:
        """Its own page."""
        page = self.cell.output / "report.html" if self.cell.output else None
        return page if page is not None and page.is_file() else None


@dataclass(frozen=True)
class PairPictures:
    """A pair with its frames, its truth and all answers to it."""

    benchmark: str
    pair: BenchmarkPair
    captures: Mapping[Video, Capture]
    truth: tuple[Thing, ...] | None
    answers: tuple[Answer, ...]

    @property
    def name(self) -> str:
        """The pair's."""
        return self.pair.name

    def emptied(self) -> "PairPictures":
        """The same without pixels, to be kept while other pairs are read."""
        blank = np.zeros((1, 1, 3), np.uint8)
        captures = {
            video: replace(c, frames=tuple(replace(f, image=blank, ignore=None) for f in c.frames))
            for video, c in self.captures.items()
        }
        return replace(self, captures=captures)

    def frame(self, spot: Spot) -> UInt8[np.ndarray, "h w 3"] | None:
        """A reduced picture."""
        for frame in self.captures[spot[0]].frames:
            if frame.index == spot[1]:
                return fit(frame.image, LONG_SIDE)
        return None


def read_pair(
    run: FinishedRun, benchmark: str, pair: BenchmarkPair, titles: Sequence[str]
) -> PairPictures:
    """Frames, truth and answers.

    Raises
    ------
    InputError
        If the frames cannot be read.
    """
    truth = true_things(pair.truth)
    true_grid = gridded(truth or ())
    answers = []
    for (setting, method), title in zip(run.columns(benchmark), titles, strict=True):
        cell = run.cell(benchmark, setting, method, pair.name)
        if cell is not None:
            answers.append(_answer(title, cell, truth or (), true_grid))
    captures: dict[Video, Capture] = {
        "before": pair.before.read("before", silent), "after": pair.after.read("after", silent),
    }  # fmt: skip
    return PairPictures(benchmark, pair, captures, truth, tuple(answers))


def _answer(title: str, cell: Cell, truth: Sequence[Thing], true_grid: Grid) -> Answer:
    if not cell.done or cell.output is None:
        return Answer(title, cell, None)
    try:
        result = read_result(cell.output / "changes.json")
    except SceneDiffError:
        return Answer(title, cell, None)
    things = reported_things(result)
    iou = overlaps(gridded(things), true_grid, (len(things), len(truth)))
    return Answer(title, cell, result, things, matches(iou))


def key_frames(pictures: PairPictures, each: int) -> tuple[Spot, ...]:
    """Up to so many frames of each capture that see most of what changed.

    The first shows as much as possible of every object, relative to the most that any frame of the
    capture shows of it; a second one only what the first does not show well.
    """
    things = pictures.truth or tuple(t for a in pictures.answers for t in a.things)
    return tuple(s for video in VIDEOS for s in _key_frames(pictures, things, video, each))


def _key_frames(
    pictures: PairPictures, things: Sequence[Thing], video: Video, each: int
) -> list[Spot]:
    spots: list[Spot] = [(video, frame.index) for frame in pictures.captures[video].frames]
    grid = gridded(things)
    sizes = np.zeros((len(spots), len(things)))
    for (position, spot), mask in grid.items():
        if spot in spots:
            sizes[spots.index(spot), position] = mask.sum()
    shares = sizes / np.maximum(sizes.max(axis=0, initial=0), 1)
    chosen: list[int] = []
    while len(chosen) < min(each, len(spots)):
        shown = shares[chosen].max(axis=0, initial=0)
        gain = np.maximum(shares - shown, 0).sum(axis=1)
        best = int(np.argmax(gain))
        if gain[best] < 0.4:
            break
        chosen.append(best)
    if not chosen and spots:
        chosen = [len(spots) // 2]
    return [spots[i] for i in sorted(chosen)]


def truth_picture(pictures: PairPictures, spot: Spot) -> UInt8[np.ndarray, "h w 3"] | None:
    """A frame with the true changes, each in its own colour."""
    image = pictures.frame(spot)
    if image is None:
        return None
    return draw_marks(image, tuple(_true_marks(pictures, spot, image.shape[:2])), letters=_LETTERS)


def answer_picture(
    pictures: PairPictures, answer: Answer, spot: Spot
) -> UInt8[np.ndarray, "h w 3"] | None:
    """A frame with what a method reported.

    What it found has the colour and letter of the true object; what is none is pale and carries a
    question mark; what it missed in this frame is a thin outline.
    """
    image = pictures.frame(spot)
    if image is None:
        return None
    height, width = image.shape[:2]
    marks = []
    for position, thing in enumerate(answer.things):
        view = thing.views.get(spot)
        if view is None:
            continue
        true = answer.found.get(position)
        tint = FALSE if true is None else colour_of(true)
        name = "?" if true is None else letter_of(true)
        mask = mask_at(view, height, width)
        marks.append(Mark(position, thing.kind, mask, tint, f"{name} {thing.kind}"))
    canvas = draw_marks(image, tuple(marks), letters=_LETTERS).copy()
    for mark in _true_marks(pictures, spot, (height, width)):
        if mark.id not in answer.found.values():
            outline(canvas, mark.mask, mark.colour, 1)
    return canvas


def _true_marks(pictures: PairPictures, spot: Spot, size: tuple[int, int]) -> list[Mark]:
    return [
        Mark(
            i, thing.kind, mask_at(thing.views[spot], *size), colour_of(i),
            f"{letter_of(i)} {thing.kind}",
        )
        for i, thing in enumerate(pictures.truth or ())
        if spot in thing.views
    ]  # fmt: skip


def colour_of(position: int) -> Colour:
    """Colour of a true object."""
    return IDENTITY[position % len(IDENTITY)]


def letter_of(position: int) -> str:
    """A to Z, then A1, B1 and so on."""
    turn, letter = divmod(position, 26)
    return chr(ord("A") + letter) + (str(turn) if turn else "")


def said(pictures: PairPictures, answer: Answer) -> str:
    """An answer in a line: found, missed, and not there."""
    if answer.result is None:
        return f"failed: {answer.cell.reason or 'its answer is gone'}"
    if pictures.truth is None:
        count = len(answer.things)
        return f"{count} reported object" + ("" if count == 1 else "s")
    missed = [letter_of(i) for i in range(len(pictures.truth)) if i not in answer.found.values()]
    wrong = [
        letter_of(j)
        for i, j in answer.found.items()
        if answer.things[i].kind != pictures.truth[j].kind
    ]
    parts = [f"{len(answer.found)} of {len(pictures.truth)} found"]
    parts += [f"missed {', '.join(missed)}"] if missed else []
    parts += [f"wrong type {', '.join(sorted(wrong))}"] if wrong else []
    false = len(answer.things) - len(answer.found)
    parts += [f"{false} that {'is' if false == 1 else 'are'} none"] if false else []
    return " · ".join(parts)
