"""RC-3D as a benchmark: two photos a pair, one changed thing, a box for it in both.

In the photo that lacks the thing its box marks the place where it would be. An answer that has a
mask in one photo only is carried into the other through depth and cameras of the run's geometry.
The sensor's depth cannot serve as a known geometry: the data set has no cameras.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from data_tools.benchmarks.benchmark import BenchmarkPair
from data_tools.benchmarks.box_ap import Convention, Protocol, ScoredBox, box_ranking_in_picture
from data_tools.benchmarks.folder_checks import Size, picture_size
from data_tools.benchmarks.hand_boxes import Box
from data_tools.benchmarks.rc3d import annotated_photos
from data_tools.benchmarks.symmetric import saved_views, working_mask
from scenediff_classic import masks
from scenediff_classic.cameras import project, source_from_view, unproject
from scenediff_classic.dataset import PredictedObject, find_prediction, read_prediction
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.average_precision import Ranking, average_precision
from scenediff_classic.types import VIDEOS, Video, View

Present = Literal["first", "second"]


@dataclass(frozen=True)
class BoxesOfPair:
    """What is kept of a judged pair."""

    present: Ranking
    absent: Ranking


@dataclass(frozen=True)
class _Annotated:
    """A pair: (file, boxes) of each photo."""

    name: str
    part: str
    files: Mapping[Video, Path]
    boxes: Mapping[Video, tuple[Box, ...]]


@dataclass(frozen=True)
class Rc3dBenchmark:
    """The pairs of all parts below a folder."""

    root: Path
    protocol: Protocol = "raw"
    convention: Convention = "half-open"
    present: Present = "first"
    """Which photo of a pair shows the thing; the annotations do not say."""
    name: str = "rc3d"

    @property
    def metrics(self) -> Mapping[str, str]:
        """AP of boxes at IoU 0.5."""
        return {"both": "AP50 both", "present": "AP50 present", "absent": "AP50 absent"}

    def pairs(self) -> tuple[BenchmarkPair, ...]:
        """In the order of the annotations; the group is the part."""
        return tuple(
            BenchmarkPair(
                item.name,
                CaptureOptions(item.files["before"]),
                CaptureOptions(item.files["after"]),
                group=item.part,
                truth=self.root / item.part / "coco_annotations.json",
            )
            for item in self._annotated.values()
        )

    def problems(self) -> tuple[str, ...]:
        """Everything that is wrong with annotations, photos and depth pictures."""
        files = _annotation_files(self.root)
        if not files:
            return (f"{self.root} holds no part1/coco_annotations.json and so on.",)
        return tuple(problem for file in files for problem in _problems(file))

    def statistics(self) -> Mapping[str, float]:
        """Boxes, and their mean share of the picture."""
        shares = [
            box[2] * box[3] / (size[0] * size[1])
            for item in self._annotated.values()
            for video in VIDEOS
            if (size := picture_size(item.files[video])) is not None
            for box in item.boxes[video]
        ]
        return {
            "parts": len(_annotation_files(self.root)),
            "boxes": len(shares),
            "mean box area": float(np.mean(shares)) if shares else 0.0,
        }

    def judge(self, pair: BenchmarkPair, run: Path | None) -> BoxesOfPair:
        """Boxes of each photo against the annotated ones."""
        item = self._annotated[pair.name]
        sizes: dict[Video, Size] = {video: _size(item.files[video]) for video in VIDEOS}
        found = {video: [] for video in VIDEOS} if run is None else boxes_in_both(run, sizes)
        rankings = {
            video: box_ranking_in_picture(
                found[video], item.boxes[video], sizes[video], self.protocol, self.convention
            )
            for video in VIDEOS
        }
        order = VIDEOS if self.present == "first" else VIDEOS[::-1]
        return BoxesOfPair(*(rankings[video] for video in order))

    def pool(self, judged: Sequence[BoxesOfPair]) -> dict[str, float | None]:
        """All boxes of the present photos, of the absent ones, and of both."""
        views = {
            "both": [r for item in judged for r in (item.present, item.absent)],
            "present": [item.present for item in judged],
            "absent": [item.absent for item in judged],
        }
        return {key: _precision(Ranking.pooled(rankings)) for key, rankings in views.items()}

    @cached_property
    def _annotated(self) -> dict[str, _Annotated]:
        files = _annotation_files(self.root)
        if not files:
            raise InputError(f"{self.root} holds no part1/coco_annotations.json and so on.")
        found = [item for file in files for item in _pairs_in(file)]
        return {item.name: item for item in found}


def boxes_in_both(run: Path, sizes: Mapping[Video, Size]) -> dict[Video, list[ScoredBox]]:
    """Boxes of a run's objects in two single photos: of their masks, else carried over.

    Raises
    ------
    InputError
        The run's result or geometry cannot be read.
    """
    path = find_prediction(run)
    found: dict[Video, list[ScoredBox]] = {video: [] for video in VIDEOS}
    if path is None:
        return found
    views = {video: saved_views(run, video) for video in VIDEOS}
    for item in read_prediction(path).objects:
        for video, other in zip(VIDEOS, VIDEOS[::-1], strict=True):
            own = next((v for v in item.views if v.video == video and masks.area(v.mask)), None)
            if own is not None:
                found[video].append(ScoredBox(masks.bbox(own.mask), own.confidence))
            elif views[video] and views[other]:
                box = carried_box(item, views[other][0], views[video][0], sizes[video])
                found[video].extend([box] if box is not None else [])
    return found


def carried_box(item: PredictedObject, source: View, target: View, size: Size) -> ScoredBox | None:
    """Box of an object's pixels in another view's input picture; None if none comes to lie there.

    Parameters
    ----------
    size : (height, width)
        Of the target's input picture, to which the box is cut.
    """
    own = next((v for v in item.views if (v.video, v.frame) == source.key), None)
    if own is None:
        return None
    chosen = working_mask(masks.decode(own.mask), source) & np.isfinite(source.depth)
    points = unproject(source)[chosen].astype(float)
    xy, _ = project(points, target.intrinsics, target.cam_from_world)
    xy = xy[np.isfinite(xy).all(axis=1)]
    if not len(xy):
        return None
    placed = source_from_view(xy, target.lens, target.intrinsics)
    low = np.clip(placed.min(axis=0), 0, size[::-1])
    high = np.clip(placed.max(axis=0), 0, size[::-1])
    if not (high > low).all():
        return None
    x, y, wide, high_ = (float(v) for v in (*low, *(high - low)))
    return ScoredBox((x, y, wide, high_), own.confidence)


def _precision(ranking: Ranking) -> float | None:
    return average_precision(ranking) if ranking.positives or len(ranking.hit) else None


def _annotation_files(root: Path) -> list[Path]:
    return sorted(root.glob("part*/coco_annotations.json"))


def _pairs_in(file: Path) -> Iterator[_Annotated]:
    photos = annotated_photos(file)
    part = file.parent.name
    for k in range(0, len(photos) - 2, 3):
        both = dict(zip(VIDEOS, (photos[k], photos[k + 2]), strict=True))
        yield _Annotated(
            f"{part}_{Path(photos[k][0]).stem}",
            part,
            {video: file.parent / name for video, (name, _) in both.items()},
            {video: tuple(_box(row) for row in boxes) for video, (_, boxes) in both.items()},
        )


def _box(corners: np.ndarray) -> Box:
    x0, y0, x1, y1 = (float(v) for v in corners)
    return x0, y0, x1 - x0, y1 - y0


def _size(path: Path) -> Size:
    size = picture_size(path)
    if size is None:
        raise InputError(f"{path} is missing or cannot be read as a picture.")
    return size


def _problems(file: Path) -> Iterator[str]:
    try:
        photos = annotated_photos(file)
    except InputError as error:
        yield str(error)
        return
    if len(photos) % 3:
        yield f"{file} has {len(photos)} photos, which are no triples."
    names = [name for name, _ in photos]
    if len(set(names)) < len(names):
        yield f"{file} names a photo twice."
    for number, (name, boxes) in enumerate(photos):
        path = file.parent / name
        if path.resolve().parent != file.parent.resolve():
            yield f"{file} names '{name}', which is not beside it."
            continue
        size = picture_size(path)
        if size is None:
            yield f"{path} is missing or cannot be read as a picture."
        depth = path.with_name(f"depth_{path.stem}.png")
        if picture_size(depth) is None:
            yield f"{depth} is missing or cannot be read as a picture."
        if number % 3 != 1 and not len(boxes):
            yield f"{file} has no box for {name}."
        for x0, y0, x1, y1 in boxes:
            inside = size is None or (x0 >= 0 and y0 >= 0 and x1 <= size[1] and y1 <= size[0])
            if not (x1 > x0 and y1 > y0 and inside):
                yield f"{file} has a box for {name} that is empty or outside the photo."
