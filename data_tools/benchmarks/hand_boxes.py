"""Compare a result with boxes that a person drew around the changed objects.

Two kinds of truth are read: the ``changes.json`` of the PASLCD example sheets (``after_images``
with ``file`` and ``boxes`` of ``change`` and ``bbox_xyxy``), and the ``boxes.json`` that
``python -m data_tools.benchmarks.obchange`` writes (``boxes`` of ``name``, ``video``, ``frame`` and
``box``). Boxes are in pixels of the input picture: left, top, right, bottom.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.table import Table

from scenediff_classic.errors import InputError, SceneDiffError
from scenediff_classic.result.reading import read_result
from scenediff_classic.types import ChangeResult, Video

Box = tuple[float, float, float, float]
"""x, y, width, height."""


@dataclass(frozen=True)
class HandBox:
    """A changed object in one picture."""

    change: str
    """Number or name of the change; the same in every picture that shows it."""
    video: Video
    frame: str
    """Name of the picture."""
    box: Box


@dataclass(frozen=True)
class BoxScore:
    """How a result stands against hand-drawn boxes."""

    found: dict[str, float]
    """Change -> best IoU of any object's box in any boxed picture."""
    spurious: tuple[int, ...]
    """Ids of objects that match no boxed change in any picture at the least IoU."""


def box_iou(a: Box, b: Box) -> float:
    """Intersection over union of two boxes."""
    wide = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    high = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    if wide <= 0 or high <= 0:
        return 0.0
    shared = wide * high
    return shared / (a[2] * a[3] + b[2] * b[3] - shared)


def read_hand_boxes(path: Path, result: ChangeResult) -> tuple[HandBox, ...]:
    """Boxes of either kind of file; `result` turns frame numbers into picture names.

    Raises
    ------
    InputError
        If the file is of neither kind.
    """
    names = {
        (video, frame.index): Path(frame.name).name
        for video, info in (("before", result.before), ("after", result.after))
        for frame in info.frames
    }
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if "after_images" in content:
            return tuple(
                HandBox(str(b["change"]), "after", Path(p["file"]).name, _box(b["bbox_xyxy"]))
                for p in content["after_images"]
                for b in p.get("boxes", ())
            )
        return tuple(
            HandBox(b["name"], b["video"], names[b["video"], int(b["frame"])], _box(b["box"]))
            for b in content["boxes"]
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} holds no hand-drawn boxes of these pictures.") from error


def score_boxes(result: ChangeResult, truth: Sequence[HandBox], least_iou: float = 0.5) -> BoxScore:
    """Best IoU per boxed change, and the objects that match none."""
    infos = {"before": result.before, "after": result.after}
    boxes: dict[tuple[Video, int], list[HandBox]] = {}
    for item in truth:
        for frame in infos[item.video].frames:
            if Path(frame.name).name == item.frame:
                boxes.setdefault((item.video, frame.index), []).append(item)
    found = {item.change: 0.0 for item in truth}
    spurious = []
    for item in result.objects:
        best = 0.0
        for view in item.views:
            for hand in boxes.get((view.video, view.frame), ()):
                iou = box_iou(view.bbox, hand.box)
                found[hand.change] = max(found[hand.change], iou)
                best = max(best, iou)
        if best < least_iou:
            spurious.append(item.id)
    return BoxScore(found, tuple(spurious))


def _box(corners: Sequence[float]) -> Box:
    left, top, right, bottom = (float(v) for v in corners)
    return left, top, right - left, bottom - top


@dataclass(frozen=True)
class HandBoxes:
    """Print which boxed changes a finished run found."""

    out: tyro.conf.Positional[Path]
    """Output folder of `scenediff-classic detect`."""
    truth: tyro.conf.Positional[Path]
    """The changes.json or boxes.json with hand-drawn boxes."""
    least_iou: float = 0.5

    def __call__(self) -> BoxScore:
        """Print a table and return the scores."""
        result = read_result(self.out / "changes.json")
        score = score_boxes(result, read_hand_boxes(self.truth, result), self.least_iou)
        table = Table("change", "best IoU", "found")
        for change, iou in sorted(score.found.items()):
            table.add_row(change, f"{iou:.2f}", "yes" if iou >= self.least_iou else "no")
        console = Console()
        console.print(table)
        hits = sum(iou >= self.least_iou for iou in score.found.values())
        console.print(f"{hits} of {len(score.found)} found, {len(score.spurious)} other objects")
        return score


if __name__ == "__main__":
    try:
        tyro.cli(HandBoxes)()
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
