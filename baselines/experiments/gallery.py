"""Where methods fail most: the worst pairs first, truth beside answer."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from baselines.experiments.finished import FinishedRun
from baselines.experiments.pair_pictures import (
    Answer,
    PairPictures,
    answer_picture,
    key_frames,
    said,
    truth_picture,
)
from baselines.experiments.truths import Spot, Thing, gridded
from scenediff_classic.report.embedded import Picture, embed


@dataclass(frozen=True)
class Worst:
    """An answer that is among the worst."""

    figure: float
    """Its own figure, 0 to 1; 0 where the method failed."""
    pair: str
    column: int
    """Position among the answers shown side by side."""


@dataclass(frozen=True)
class Exhibit:
    """One entry of the gallery."""

    rank: int
    title: str
    pair: str
    figure: str
    said: str
    where: str
    truth: Picture | None
    answer: Picture | None
    report: str | None


def worst_answers(run: FinishedRun, benchmark: str, key: str, limit: int) -> tuple[Worst, ...]:
    """The lowest figures of all methods and pairs, at most three of one method or pair.

    Pairs without a figure are left out: nothing was to be found there and nothing was reported.
    """
    found: list[Worst] = []
    for column, (setting, method) in enumerate(run.columns(benchmark)):
        score = run.score(benchmark, setting, method)
        for pair in run.pairs(benchmark):
            cell = run.cell(benchmark, setting, method, pair)
            figure = score.pairs.get(pair, {}).get(key) if score else None
            if cell is not None and not cell.done:
                figure = 0.0
            if figure is not None:
                found.append(Worst(figure, pair, column))
    chosen: list[Worst] = []
    for item in sorted(found, key=lambda w: (w.figure, w.pair, w.column)):
        same_pair = sum(c.pair == item.pair for c in chosen)
        same_method = sum(c.column == item.column for c in chosen)
        if same_pair < 3 and same_method < 3 and len(chosen) < limit and item.figure < 1:
            chosen.append(item)
    return tuple(chosen)


def exhibit(
    run: FinishedRun, pictures: PairPictures, worst: Worst, rank: int, heading: str,
    report: str | None,
) -> Exhibit:  # fmt: skip
    """An entry with its pictures, of the frame in which the answer is farthest off."""
    setting, method = run.columns(pictures.benchmark)[worst.column]
    answer = next(
        a for a in pictures.answers if (a.cell.setting, a.cell.method) == (setting, method)
    )
    spot = _worst_frame(pictures, answer)
    truth = None if spot is None else truth_picture(pictures, spot)
    told = None if spot is None else answer_picture(pictures, answer, spot)
    where = "" if spot is None else f"{spot[0]}, frame {spot[1]}"
    name = f"{pictures.name}, {where}"
    if answer.result is None:
        told = None
    return Exhibit(
        rank, answer.title, pictures.name, f"{heading} {100 * worst.figure:.1f}",
        said(pictures, answer), where,
        None if truth is None else embed(truth, f"{name}: what truly changed"),
        None if told is None else embed(told, f"{name}: what {answer.title} reported"), report,
    )  # fmt: skip


def _worst_frame(pictures: PairPictures, answer: Answer) -> Spot | None:
    """The frame with the most pixels that are wrong."""
    told, true = _unions(answer.things), _unions(pictures.truth or ())
    wrong = {
        spot: int(np.logical_xor(told[spot], true[spot]).sum())
        if spot in told and spot in true and told[spot].shape == true[spot].shape
        else int((told[spot] if spot in told else true[spot]).sum())
        for spot in sorted(told.keys() | true.keys())
    }
    if wrong:
        return max(wrong, key=lambda spot: wrong[spot])
    return next(iter(key_frames(pictures, 1)), None)


def _unions(things: Sequence[Thing]) -> dict[Spot, np.ndarray]:
    out: dict[Spot, np.ndarray] = {}
    for (_, spot), mask in gridded(things).items():
        out[spot] = mask if spot not in out else out[spot] | mask
    return out
