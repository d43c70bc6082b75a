"""Score the method on pairs of visits of the ObChange rooms, changed and unchanged.

``python -m data_tools.benchmarks.obchange_scores ROOT -o OUT`` writes each pair with its known
geometry to OUT/pairs, the results to OUT/results, prints a table, and keeps it in
OUT/obchange.json. Finished pairs are kept, so a killed run continues.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from data_tools.benchmarks.hand_boxes import HandBox, box_iou, read_hand_boxes, score_boxes
from data_tools.benchmarks.obchange import write_visits
from scenediff_classic.detection_run import CaptureOptions, run_detection
from scenediff_classic.errors import SceneDiffError
from scenediff_classic.evaluation.average_precision import Ranking, average_precision
from scenediff_classic.pipeline import detect_changes
from scenediff_classic.presets import Preset, configured
from scenediff_classic.result.reading import read_result
from scenediff_classic.types import ChangeResult
from scenediff_classic.workspace import write_atomic


@dataclass(frozen=True)
class VisitPair:
    """Two visits of a room, or those of their views between which nothing changed."""

    room: str
    first: int
    second: int
    views: tuple[int, ...] = ()

    @property
    def name(self) -> str:
        """For folders and tables."""
        views = f"_views_{'_'.join(map(str, self.views))}" if self.views else ""
        return f"{self.room}_{self.first}_{self.second}{views}"


PAIRS = (
    VisitPair("Kitchen", 2, 3),
    VisitPair("SmallRoom", 1, 2),
    VisitPair("SmallRoom", 5, 6),
    VisitPair("SmallRoom", 3, 4, (0, 2, 4, 6, 7)),
    VisitPair("Kitchen", 1, 2, (0, 1)),
    VisitPair("Kitchen", 1, 4, (5,)),
)
"""Pairs that overlap well; in the last three nothing that is boxed changed."""


@dataclass(frozen=True)
class VisitScore:
    """How one pair came out."""

    pair: str
    changes: int
    """Boxed objects that changed."""
    found: int
    """Of these, how many have an object at box IoU 0.5 in some picture."""
    others: int
    """Reported objects that match no boxed change."""
    sure_others: int
    """Of these, how many have a confidence of at least one half."""
    ap50: float | None
    """Box AP at IoU 0.5 over all pictures of both visits; None without changes."""


def box_ranking(result: ChangeResult, truth: Sequence[HandBox], least_iou: float = 0.5) -> Ranking:
    """Every box of a result against the drawn boxes of its picture, the surest first.

    A drawn box can be found once; what finds it again counts as wrong.
    """
    names = {
        (video, frame.index): Path(frame.name).name
        for video, info in (("before", result.before), ("after", result.after))
        for frame in info.frames
    }
    boxes = [(item.confidence, view) for item in result.objects for view in item.views]
    boxes.sort(key=lambda box: -box[0])
    free = list(truth)
    hits = []
    for _, view in boxes:
        here = [
            b for b in free if (b.video, b.frame) == (view.video, names[view.video, view.frame])
        ]
        best = max(here, key=lambda b: box_iou(view.bbox, b.box), default=None)
        hit = best is not None and box_iou(view.bbox, best.box) >= least_iou
        if best is not None and hit:
            free.remove(best)
        hits.append(hit)
    return Ranking(np.array([c for c, _ in boxes], float), np.array(hits, bool), len(truth))


@dataclass(frozen=True)
class ObChangeBenchmark:
    """Run and score the visits."""

    root: tyro.conf.Positional[Path]
    """Folder that holds annotations.json."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for pairs, results and the table."""
    preset: Preset = "balanced"
    """As in `scenediff-classic detect`."""
    overwrite: bool = False
    """Replace results of other options."""

    def __call__(self, pairs: Sequence[VisitPair] = PAIRS) -> list[VisitScore]:
        """Detect, score, print, and write ``obchange.json``."""
        console = Console()
        scores, rankings = [], []
        for pair in pairs:
            console.print(pair.name)
            result, truth = self._detect(pair)
            boxes = score_boxes(result, truth)
            ranking = box_ranking(result, truth)
            rankings.append(ranking)
            sure = [o.id for o in result.objects if o.confidence >= 0.5]
            scores.append(
                VisitScore(
                    pair=pair.name,
                    changes=len(boxes.found),
                    found=sum(iou >= 0.5 for iou in boxes.found.values()),
                    others=len(boxes.spurious),
                    sure_others=len(set(sure) & set(boxes.spurious)),
                    ap50=average_precision(ranking) if truth else None,
                )
            )
        pooled = average_precision(Ranking.pooled(rankings))
        console.print(_table(scores, pooled))
        content = {"pairs": [asdict(score) for score in scores], "pooled_ap50": pooled}
        write_atomic(self.out / "obchange.json", json.dumps(content, indent=2) + "\n")
        return scores

    def _detect(self, pair: VisitPair) -> tuple[ChangeResult, tuple[HandBox, ...]]:
        folder = self.out / "pairs" / pair.name
        if not folder.exists():
            write_visits(self.root, pair.room, pair.first, pair.second, folder, pair.views)
        known = folder / "geometry.npz"
        config = configured(self.preset, geometry=known)
        destination = self.out / "results" / pair.name
        run_detection(
            CaptureOptions(folder / "before"),
            CaptureOptions(folder / "after"),
            destination,
            lambda before, after, workspace, progress: detect_changes(
                before, after, config, workspace=workspace, progress=progress
            ),
            config,
            uses=(known,),
            overwrite=self.overwrite,
            command=tuple(sys.argv),
        )
        result = read_result(destination / "changes.json")
        return result, read_hand_boxes(folder / "boxes.json", result)


def _table(scores: Sequence[VisitScore], pooled: float) -> Table:
    table = Table(title=f"ObChange, hand-drawn boxes: AP50 of all pictures {100 * pooled:.1f}")
    table.add_column("visits")
    for name in ("found", "others", "of them sure", "box AP50"):
        table.add_column(name, justify="right")
    for score in scores:
        table.add_row(
            score.pair,
            f"{score.found} of {score.changes}",
            str(score.others),
            str(score.sure_others),
            "-" if score.ap50 is None else f"{100 * score.ap50:.1f}",
        )
    return table


if __name__ == "__main__":
    try:
        tyro.cli(ObChangeBenchmark)()
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
