"""One pair: prediction and truth brought onto one grid, compared, judged."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from scenediff_classic import masks
from scenediff_classic.dataset import SAMPLE_STEP, AnnotatedPair, PredictedObject, Prediction
from scenediff_classic.evaluation.average_precision import Ranking, average_precision
from scenediff_classic.evaluation.matching import DROPPED, HIT
from scenediff_classic.evaluation.metrics import Metrics, PixelCounts
from scenediff_classic.evaluation.rules import Grid, Matcher, Rules
from scenediff_classic.types import VIDEOS, Kind, Rle, Video


@dataclass(frozen=True)
class PairScores:
    """Everything that the metrics need to know of a pair."""

    pixels: PixelCounts
    regions: Ranking
    objects: Ranking
    typed_objects: Ranking
    reported_objects: int


@dataclass(frozen=True)
class _Region:
    """One object in one sampled frame, on the grid."""

    owner: int
    """The truth's object number, or the position among the predicted objects."""
    kind: Kind
    video: Video
    frame: int
    mask: Rle
    confidence: float = 1.0


def score_pair(truth: AnnotatedPair, prediction: Prediction, rules: Rules) -> PairScores:
    """Compare a prediction with the truth."""
    grid = rules.grid(truth, prediction)
    true = _true_regions(truth, grid)
    reported = _reported_regions(prediction, grid)
    shared = _intersections(reported, true)
    objects = _object_iou(prediction.objects, reported, true, shared)
    agree = _type_agreement(prediction.objects, true, rules)
    confidence = np.array([_mean_confidence(item) for item in prediction.objects], float)
    flagged = sum(item.kind is not None for item in truth.objects)
    return PairScores(
        pixels=_pixels(reported, true),
        regions=_ranked(
            np.array([r.confidence for r in reported], float),
            _region_iou(reported, true, shared),
            rules.match_regions,
            len(true),
        ),
        objects=_ranked(confidence, objects, rules.match_objects, flagged),
        typed_objects=_ranked(confidence, objects * agree, rules.match_objects, flagged),
        reported_objects=len(prediction.objects),
    )


def summarise(scores: Sequence[PairScores], rules: Rules) -> Metrics:
    """Metrics over pairs: detections and pixels are pooled, not averaged pair by pair."""
    pixels = sum((s.pixels for s in scores), PixelCounts())
    objects = Ranking.pooled(s.objects for s in scores)
    typed_objects = Ranking.pooled(s.typed_objects for s in scores)

    def precision(ranking: Ranking) -> float | None:
        empty = not len(ranking.hit) and not ranking.positives
        return rules.undefined if empty else average_precision(ranking)

    return Metrics(
        px_im_iou=pixels.hit / pixels.total if pixels.total else rules.undefined,
        obj_im_ap=precision(Ranking.pooled(s.regions for s in scores)),
        obj_sc_ap=precision(objects),
        obj_sc_ap_typed=precision(typed_objects),
        true_objects=objects.positives,
        reported_objects=sum(s.reported_objects for s in scores),
        found_objects=int(objects.hit.sum()),
        pixels=pixels,
    )


def _true_regions(pair: AnnotatedPair, grid: Grid) -> list[_Region]:
    """Masks of the flagged objects in the sampled frames of the captures that they are in.

    A mask that vanishes on the grid stays: it is still there to be found. Two entries that share
    an object number share their regions; the later entry decides the change type.
    """
    regions: dict[tuple[int, Video, int], _Region] = {}
    for item in pair.objects:
        for video in VIDEOS:
            track = pair.track(video, item.object_id) if item.present(video) else None
            for annotated in track.masks if track else ():
                frame, rest = divmod(annotated.frame, SAMPLE_STEP)
                if rest == 0 and item.kind is not None:
                    mask = masks.resize(annotated.mask, *grid(video, frame))
                    region = _Region(item.object_id, item.kind, video, frame, mask)
                    regions[item.object_id, video, frame] = region
    return list(regions.values())


def _reported_regions(prediction: Prediction, grid: Grid) -> list[_Region]:
    return [
        _Region(
            position,
            item.kind,
            view.video,
            view.frame,
            masks.resize(view.mask, *grid(view.video, view.frame)),
            view.confidence,
        )
        for position, item in enumerate(prediction.objects)
        for view in item.views
    ]


def _intersections(
    reported: Sequence[_Region], true: Sequence[_Region]
) -> Int64[np.ndarray, "n m"]:
    """Pixels that each reported region shares with each true one; 0 across frames."""
    shared = np.zeros((len(reported), len(true)), np.int64)
    columns: dict[tuple[Video, int], list[int]] = {}
    for column, region in enumerate(true):
        columns.setdefault((region.video, region.frame), []).append(column)
    for row, region in enumerate(reported):
        for column in columns.get((region.video, region.frame), ()):
            shared[row, column] = masks.intersection(region.mask, true[column].mask)
    return shared


def _region_iou(
    reported: Sequence[_Region], true: Sequence[_Region], shared: Int64[np.ndarray, "n m"]
) -> Float64[np.ndarray, "n m"]:
    return _iou(_areas(reported), _areas(true), shared)


def _object_iou(
    items: Sequence[PredictedObject],
    reported: Sequence[_Region],
    true: Sequence[_Region],
    shared: Int64[np.ndarray, "n m"],
) -> Float64[np.ndarray, "p q"]:
    """IoU over all frames of both captures, of predicted objects with true ones in view."""
    owners = list(dict.fromkeys(region.owner for region in true))
    rows = _membership([r.owner for r in reported], list(range(len(items))))
    columns = _membership([r.owner for r in true], owners)
    return _iou(rows.T @ _areas(reported), columns.T @ _areas(true), rows.T @ shared @ columns)


def _membership(owners: Sequence[int], groups: Sequence[int]) -> Int64[np.ndarray, "n g"]:
    """One where the region belongs to the object."""
    own = np.array(owners, np.int64).reshape(-1, 1)
    return (own == np.array(groups, np.int64)).astype(np.int64)


def _areas(regions: Sequence[_Region]) -> Int64[np.ndarray, "n"]:
    return np.array([masks.area(region.mask) for region in regions], np.int64)


def _iou(
    first: Int64[np.ndarray, "n"], second: Int64[np.ndarray, "m"], shared: Int64[np.ndarray, "n m"]
) -> Float64[np.ndarray, "n m"]:
    return shared / np.maximum(first[:, None] + second - shared, 1)


def _type_agreement(
    items: Sequence[PredictedObject], true: Sequence[_Region], rules: Rules
) -> Float64[np.ndarray, "p q"]:
    """One where the change types agree, else zero."""
    kinds: dict[int, Kind] = {}
    for region in true:
        kinds.setdefault(region.owner, region.kind)
    rows = [[rules.same_type(item.kind, kind) for kind in kinds.values()] for item in items]
    return np.array(rows, float).reshape(len(items), len(kinds))


def _mean_confidence(item: PredictedObject) -> float:
    """Paper, Sec. 3: the mean of the per-view confidences; 0 without a view."""
    return float(np.mean([view.confidence for view in item.views])) if item.views else 0.0


def _ranked(
    confidence: Float64[np.ndarray, "n"],
    iou: Float64[np.ndarray, "n m"],
    match: Matcher,
    positives: int,
) -> Ranking:
    """Detections by falling confidence (equals keep their order), judged, less dropped ones."""
    order = np.argsort(-confidence, kind="stable")
    verdicts = match(iou[order])
    kept = verdicts != DROPPED
    return Ranking(confidence[order][kept], verdicts[kept] == HIT, positives)


def _pixels(reported: Sequence[_Region], true: Sequence[_Region]) -> PixelCounts:
    """Union of all masks against union of all masks, frame by frame."""
    mine, theirs = _unions(reported), _unions(true)
    hit = sum(masks.intersection(mine[key], theirs[key]) for key in mine.keys() & theirs.keys())
    marked = sum(masks.area(mask) for mask in mine.values())
    changed = sum(masks.area(mask) for mask in theirs.values())
    return PixelCounts(hit, false=marked - hit, missed=changed - hit)


def _unions(regions: Sequence[_Region]) -> dict[tuple[Video, int], Rle]:
    frames: dict[tuple[Video, int], list[Rle]] = {}
    for region in regions:
        frames.setdefault((region.video, region.frame), []).append(region.mask)
    return {key: masks.merge(found) for key, found in frames.items()}
