"""Judge the boxes of finished runs: ``python -m baselines.cyws.box_scores RUNS TRUTH``.

As the paper's supplement ("Details about CYWS-3D") judges them on the SceneDiff Benchmark: obj/im
AP, once of masks made of the boxes and once of the boxes themselves, at IoU 0.5. Boxes come in
pairs; a false box whose partner in the other capture is right is ignored there, for it marks where
the object is missing. All figures are given with this rule and without it.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from jaxtyping import Float64
from rich.console import Console
from rich.table import Table

from baselines.cyws.raw_boxes import NAME, RawBox, Spot, read_boxes
from data_tools.benchmarks.hand_boxes import box_iou
from scenediff_classic import masks
from scenediff_classic.dataset import (
    SAMPLE_STEP,
    AnnotatedPair,
    PredictedObject,
    PredictedView,
    Prediction,
    read_annotations,
)
from scenediff_classic.errors import InputError, SceneDiffError
from scenediff_classic.evaluation.average_precision import Ranking, average_precision
from scenediff_classic.evaluation.benchmark import evaluate, find_pairs
from scenediff_classic.evaluation.matching import DROPPED, HIT, ignore_partnered
from scenediff_classic.evaluation.rules import Grid, Mode, Rules, rules_of
from scenediff_classic.types import VIDEOS
from scenediff_classic.workspace import write_atomic

Shape = Literal["box", "mask"]
SHAPES: tuple[Shape, ...] = ("box", "mask")


@dataclass(frozen=True)
class Figures:
    """Of all pairs together; AP from 0 to 1, None with nothing to find and nothing reported."""

    ap50: float | None
    reported: int
    """Boxes that count."""
    right: int
    truths: int
    """Objects in single frames."""


@dataclass(frozen=True)
class BoxScores:
    """Print box AP and mask AP of runs of the networks."""

    runs: tyro.conf.Positional[Path]
    """Holds RUNS/<pair>, each the output folder of scenediff-cyws2d or scenediff-cyws3d."""
    truth: tyro.conf.Positional[Path]
    """Holds <pair>/segments.json or segments.pkl, as for scenediff-classic evaluate."""
    mode: Mode = "strict"
    """As for scenediff-classic evaluate."""
    out: Path | None = None
    """File for the figures (JSON)."""

    def __call__(self) -> dict[str, Figures]:
        """Judge, print, and return the rows of the table."""
        rules, console = rules_of(self.mode), Console()
        folders, _ = find_pairs(self.truth)
        answers = {f: self.runs / f.name / NAME for f in folders}
        there = {folder: path for folder, path in answers.items() if path.is_file()}
        if not there:
            raise InputError(
                f"{self.runs} holds no <pair>/{NAME} of these pairs: scenediff-cyws2d and "
                "scenediff-cyws3d leave it in their output folders."
            )
        counted = folders if rules.counts_missing else tuple(there)
        pairs = [(read_annotations(f), read_boxes(there[f]) if f in there else ()) for f in counted]
        rows: dict[str, Figures] = {}
        for shape in SHAPES:
            overlaps = [compared(truth, boxes, shape, rules) for truth, boxes in pairs]
            for ignore in (False, True):
                rankings = [ranking(overlap, rules, ignore) for overlap in overlaps]
                name = "raw boxes" if shape == "box" else "masks of the boxes"
                rows[name + (", ignore rule" if ignore else "")] = _figures(rankings, rules)
        objects = evaluate(self.runs, self.truth, self.mode).metrics.obj_im_ap
        console.print(_table(rows, objects, f"{len(counted)} pairs, {self.mode} mode"))
        if len(there) < len(folders):
            fate = "counted as all missed" if rules.counts_missing else "left out"
            console.print(f"Pairs without {NAME}: {len(folders) - len(there)}, {fate}.")
        if self.out is not None:
            content = {name: asdict(row) for name, row in rows.items()}
            content["masks of objects"] = {"ap50": objects}
            write_atomic(self.out, json.dumps(content, indent=1) + "\n")
        return rows


@dataclass(frozen=True)
class Compared:
    """Boxes of one pair, the surest first, laid over the truth."""

    score: Float64[np.ndarray, "n"]
    own: Float64[np.ndarray, "n m"]
    """IoU of every box with every truth."""
    partner: Float64[np.ndarray, "n m"]
    """The same of its partner."""


def compared(truth: AnnotatedPair, boxes: Sequence[RawBox], shape: Shape, rules: Rules) -> Compared:
    """Lay boxes, or their masks, over the truth.

    Parameters
    ----------
    shape : {"box", "mask"}
        What is laid over the truth: the box over the box of the true mask, or the mask that
        regions made of it over the true mask, at the grid of the rules.
    """
    boxes = sorted(boxes, key=lambda box: -box.score)
    true = _true_spots(truth)
    grid = rules.grid(truth, _prediction(boxes))
    return Compared(
        np.array([box.score for box in boxes], float),
        _overlap([box.here for box in boxes], true, shape, grid),
        _overlap([box.partner for box in boxes], true, shape, grid),
    )


def ranking(overlap: Compared, rules: Rules, ignore: bool) -> Ranking:
    """The boxes of one pair, judged.

    Parameters
    ----------
    ignore : bool
        Leave out false boxes whose partner is right (see `matching.ignore_partnered`).
    """
    verdicts = rules.match_regions(overlap.own)
    if ignore:
        verdicts = ignore_partnered(verdicts, overlap.partner)
    kept = verdicts != DROPPED
    return Ranking(overlap.score[kept], verdicts[kept] == HIT, overlap.own.shape[1])


def _true_spots(pair: AnnotatedPair) -> list[Spot]:
    """Changed objects in the sampled frames of the captures that they are in."""
    found: dict[tuple[int, str, int], Spot] = {}
    for item in pair.objects:
        for video in VIDEOS:
            track = pair.track(video, item.object_id) if item.present(video) else None
            for annotated in track.masks if track and item.kind else ():
                frame, rest = divmod(annotated.frame, SAMPLE_STEP)
                if rest == 0:
                    spot = Spot(video, frame, masks.bbox(annotated.mask), annotated.mask)
                    found[item.object_id, video, frame] = spot
    return list(found.values())


def _prediction(boxes: Sequence[RawBox]) -> Prediction:
    """As much as a grid needs to know: in which frame masks have which size."""
    spots = chain.from_iterable((b.here, b.partner) for b in boxes)
    views = [PredictedView(s.video, s.frame, 1.0, s.mask) for s in spots if s is not None]
    size = views[0].mask.size if views else None
    return Prediction((PredictedObject(0, "moved", tuple(views)),), size)


def _overlap(
    spots: Sequence[Spot | None], true: Sequence[Spot], shape: Shape, grid: Grid
) -> Float64[np.ndarray, "n m"]:
    out = np.zeros((len(spots), len(true)))
    columns: dict[tuple[str, int], list[tuple[int, Spot]]] = {}
    for column, spot in enumerate(true):
        placed = _on_grid(spot, grid) if shape == "mask" else spot
        columns.setdefault((spot.video, spot.frame), []).append((column, placed))
    for row, spot in enumerate(spots):
        here = columns.get((spot.video, spot.frame)) if spot else None
        if spot is None or here is None:
            continue
        placed = _on_grid(spot, grid) if shape == "mask" else spot
        for column, other in here:
            if shape == "mask":
                out[row, column] = masks.iou(placed.mask, other.mask)
            else:
                out[row, column] = box_iou(_share(placed), _share(other))
    return out


def _on_grid(spot: Spot, grid: Grid) -> Spot:
    return replace(spot, mask=masks.resize(spot.mask, *grid(spot.video, spot.frame)))


def _share(spot: Spot) -> tuple[float, float, float, float]:
    """The box as shares of the picture: truth may be of another size, and IoU stays the same."""
    height, width = spot.mask.size
    x, y, wide, high = spot.box
    return x / width, y / height, wide / width, high / height


def _figures(rankings: Sequence[Ranking], rules: Rules) -> Figures:
    pooled = Ranking.pooled(rankings)
    empty = not len(pooled.hit) and not pooled.positives
    ap = rules.undefined if empty else average_precision(pooled)
    return Figures(ap, len(pooled.hit), int(pooled.hit.sum()), pooled.positives)


def _table(rows: dict[str, Figures], objects: float | None, title: str) -> Table:
    table = Table("obj/im", title=f"{title}: AP at IoU 0.5, percent")
    for heading in ("AP50", "reported", "right", "true"):
        table.add_column(heading, justify="right")
    for name, row in rows.items():
        table.add_row(name, _percent(row.ap50), f"{row.reported}", f"{row.right}", f"{row.truths}")
    table.add_row("masks of objects (changes.json)", _percent(objects), "", "", "")
    return table


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}"


if __name__ == "__main__":
    try:
        tyro.cli(BoxScores)()
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
