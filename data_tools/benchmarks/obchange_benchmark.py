"""The ObChange pairs of `obchange_scores`, as a benchmark.

A pair's pictures, known geometry and boxes are written once, below a folder of prepared pairs.
"""

import hashlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from data_tools.benchmarks.benchmark import BenchmarkPair
from data_tools.benchmarks.folder_checks import picture_size
from data_tools.benchmarks.hand_boxes import read_hand_boxes, score_boxes
from data_tools.benchmarks.obchange import changed_boxes, write_visits
from data_tools.benchmarks.obchange_scores import PAIRS, VisitPair, box_ranking
from data_tools.benchmarks.obchange_visits import read_visit
from data_tools.benchmarks.truth_pictures import mean
from scenediff_classic.dataset import records
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.average_precision import (
    NO_DETECTIONS,
    Ranking,
    average_precision,
)
from scenediff_classic.result.reading import read_result

SURE = 0.5
"""Confidence from which on an object that is not there is a false alarm."""


@dataclass(frozen=True)
class JudgedVisits:
    """What is kept of a judged pair."""

    boxes: Ranking
    changes: int
    found: int
    reported: int
    right: int
    alarms: int
    """Sure objects that match no boxed change."""
    answered: bool


@dataclass(frozen=True)
class ObChangeBenchmark:
    """Three pairs of visits with changes, three without."""

    root: Path
    work: Path | None = None
    """Folder for the prepared pairs; one in the user's cache if left out."""
    name: str = "obchange"

    @property
    def metrics(self) -> Mapping[str, str]:
        """Boxes, objects found, objects that are right, unchanged pairs without a false alarm."""
        return {
            "box_ap50": "box AP50",
            "found": "found",
            "right": "right of those reported",
            "quiet": "unchanged pairs without a sure false alarm",
        }

    def pairs(self) -> tuple[BenchmarkPair, ...]:
        """In the order of `PAIRS`; the group says whether anything that is boxed changed."""
        return tuple(self._prepared(pair) for pair in PAIRS)

    def problems(self) -> tuple[str, ...]:
        """Everything that is wrong with annotations and pictures."""
        return tuple(dict.fromkeys(problem for pair in PAIRS for problem in self._of(pair)))

    def statistics(self) -> Mapping[str, float]:
        """Changed objects by kind, pictures, boxes."""
        kinds = {"added": 0, "removed": 0, "moved": 0}
        pictures = boxes = 0
        for pair in PAIRS:
            if not pair.views:
                visits = [read_visit(self.root, pair.room, n) for n in (pair.first, pair.second)]
                changed = changed_boxes(*visits)
                for kind in kinds:
                    kinds[kind] += len({item.name for item in changed if item.kind == kind})
                pictures += sum(map(len, visits))
                boxes += len(changed)
            else:
                pictures += 2 * len(pair.views)
        changed_pairs = sum(not pair.views for pair in PAIRS)
        return {
            "pairs": len(PAIRS),
            "pairs: changed": changed_pairs,
            "pairs: unchanged": len(PAIRS) - changed_pairs,
            "objects": sum(kinds.values()),
            **kinds,
            "pictures": pictures,
            "boxes": boxes,
        }

    def judge(self, pair: BenchmarkPair, run: Path | None) -> JudgedVisits:
        """Boxes and objects against the drawn boxes."""
        assert pair.truth is not None
        if run is None or not (run / "changes.json").is_file():
            content = records.mapping(records.read_json(pair.truth), str(pair.truth))
            drawn = records.sequence(content.get("boxes"), f"{pair.truth}: 'boxes'")
            changes = len({str(box["name"]) for box in drawn})
            missed = Ranking(NO_DETECTIONS.confidence, NO_DETECTIONS.hit, len(drawn))
            return JudgedVisits(missed, changes, 0, 0, 0, 0, answered=False)
        result = read_result(run / "changes.json")
        truth = read_hand_boxes(pair.truth, result)
        score = score_boxes(result, truth)
        sure = {item.id for item in result.objects if item.confidence >= SURE}
        return JudgedVisits(
            boxes=box_ranking(result, truth),
            changes=len(score.found),
            found=sum(iou >= 0.5 for iou in score.found.values()),
            reported=len(result.objects),
            right=len(result.objects) - len(score.spurious),
            alarms=len(sure & set(score.spurious)),
            answered=True,
        )

    def pool(self, judged: Sequence[JudgedVisits]) -> dict[str, float | None]:
        """Boxes and objects of all pairs together; a failed unchanged pair is not quiet."""
        boxes = Ranking.pooled(item.boxes for item in judged)
        changes = sum(item.changes for item in judged)
        reported = sum(item.reported for item in judged)
        quiet = (float(j.answered and not j.alarms) for j in judged if not j.changes)
        return {
            "box_ap50": average_precision(boxes) if boxes.positives else None,
            "found": sum(item.found for item in judged) / changes if changes else None,
            "right": sum(item.right for item in judged) / reported if reported else None,
            "quiet": mean(quiet),
        }

    def _prepared(self, pair: VisitPair) -> BenchmarkPair:
        folder = (self.work or _cache_of(self.root)) / pair.name
        if not folder.exists():
            write_visits(self.root, pair.room, pair.first, pair.second, folder, pair.views)
        return BenchmarkPair(
            pair.name,
            CaptureOptions(folder / "before"),
            CaptureOptions(folder / "after"),
            group="unchanged" if pair.views else "changed",
            truth=folder / "boxes.json",
            known_geometry=folder / "geometry.npz",
        )

    def _of(self, pair: VisitPair) -> Iterator[str]:
        for number in (pair.first, pair.second):
            try:
                visit = read_visit(self.root, pair.room, number)
            except InputError as error:
                yield str(error)
                continue
            for missing in sorted(set(pair.views) - {view.view for view in visit}):
                yield f"{self.root}: {pair.room} {number} has no view {missing}."
            for view in visit:
                size = picture_size(view.colour_path)
                if size is None:
                    yield f"{view.colour_path} is missing or cannot be read as a picture."
                if picture_size(view.depth_path) is None:
                    yield f"{view.depth_path} is missing or cannot be read as a picture."
                elif size is not None and picture_size(view.depth_path) != size:
                    yield f"{view.depth_path} has another size than {view.colour_path}."
                for item in view.objects:
                    x0, y0, x1, y1 = item.box
                    high, wide = size or (y1, x1)
                    if not (0 <= x0 < x1 <= wide and 0 <= y0 < y1 <= high):
                        yield f"{view.colour_path}: the box of {item.name} is empty or outside."


def _cache_of(root: Path) -> Path:
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    notes = root / "annotations.json"
    try:
        content = notes.read_bytes()
    except OSError as error:
        raise InputError(f"{notes} cannot be read ({error.strerror}).") from error
    name = hashlib.sha256(str(root.resolve()).encode() + b"\0" + content).hexdigest()[:12]
    return caches / "scenediff-classic" / f"obchange-{name}"
