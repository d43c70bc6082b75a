"""All pairs of a benchmark: where they lie on disk, and their scores together."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from scenediff_classic.dataset import (
    Prediction,
    annotation_files,
    find_prediction,
    read_annotations,
    read_prediction,
)
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.average_precision import NO_DETECTIONS, Ranking
from scenediff_classic.evaluation.metrics import Metrics
from scenediff_classic.evaluation.pairs import PairScores, score_pair, summarise
from scenediff_classic.evaluation.rules import Mode, Rules, rules_of
from scenediff_classic.protocols import Progress, silent

Split = Literal["val", "test"]
Subset = Literal["varied", "kitchen"]
SPLITS: tuple[Split, ...] = ("val", "test")
SUBSETS: tuple[Subset, ...] = ("varied", "kitchen")


@dataclass(frozen=True)
class PairResult:
    """One row of the table."""

    pair: str
    metrics: Metrics | None
    """None for a pair that does not count."""
    problem: str | None = None
    """Why there is no usable prediction."""


@dataclass(frozen=True)
class EvaluationResult:
    """Scores of a method on a benchmark; `tables` renders it."""

    mode: Mode
    metrics: Metrics
    """Over all pairs that count, pooled."""
    pairs: tuple[PairResult, ...]
    """In the benchmark's order."""
    warnings: tuple[str, ...] = ()
    objects: Ranking = NO_DETECTIONS
    """Every reported object of the pairs that count: its confidence, and whether it is right."""


def evaluate(
    pred_root: Path,
    gt_root: Path,
    mode: Mode = "strict",
    *,
    split: Split | None = None,
    subset: Subset | None = None,
    region_duplicates: int = 1,
    object_duplicates: int = 1,
    progress: Progress = silent,
) -> EvaluationResult:
    """Score a folder of predictions against a folder of truths.

    Parameters
    ----------
    pred_root : Path
        Holds ``<pair>/changes.json`` or ``<pair>/object_masks.pkl`` (the former is preferred).
    gt_root : Path
        Holds ``<pair>/segments.json`` or ``<pair>/segments.pkl``, directly or under ``data/``;
        ``splits/{val,test}_split.json`` beside them give the pairs' order.
    mode : {"strict", "official"}
        In strict mode a pair without a usable prediction is all missed; in official mode it is
        left out.
    split, subset : str, optional
        Only the pairs that the benchmark's split files list there.
    region_duplicates, object_duplicates : int
        The published evaluator's tolerance for duplicates (official mode only).
    progress : callable

    Raises
    ------
    InputError
        A folder is absent or holds no pair, a truth that counts is unreadable, or the options
        do not fit together.
    """
    rules = rules_of(mode, region_duplicates, object_duplicates)
    if not pred_root.is_dir():
        raise InputError(f"{pred_root} is not a folder: give the folder that holds predictions.")
    folders, warnings = find_pairs(gt_root, split, subset)
    rows, scores = [], []
    for done, folder in enumerate(folders):
        progress("evaluate", done, len(folders))
        row, score = _evaluate_pair(pred_root / folder.name, folder, rules)
        rows.append(row)
        scores.extend([score] if score is not None else [])
    progress("evaluate", len(folders), len(folders))
    strangers = _strangers(pred_root, gt_root)
    if strangers:
        count = f"{len(strangers)}, the first is '{strangers[0]}'"
        warnings = (*warnings, f"Predictions without a truth, not scored: {count}.")
    unusable = sum(row.problem is not None for row in rows)
    if unusable:
        what = "Pairs without a readable prediction and truth"
        fate = "counted as all missed" if rules.counts_missing else "left out"
        warnings = (*warnings, f"{what}: {unusable} of {len(rows)}, {fate}.")
    objects = Ranking.pooled(score.objects for score in scores)
    return EvaluationResult(mode, summarise(scores, rules), tuple(rows), warnings, objects)


def _evaluate_pair(
    prediction_folder: Path, truth_folder: Path, rules: Rules
) -> tuple[PairResult, PairScores | None]:
    """Row of one pair, and its scores if it counts."""
    name = truth_folder.name
    try:
        truth = read_annotations(truth_folder)
        prediction, problem = _prediction_in(prediction_folder), None
    except InputError as error:
        if not rules.counts_missing:
            return PairResult(name, None, str(error)), None
        truth = read_annotations(truth_folder)  # a truth that cannot be read stops strict mode
        prediction, problem = Prediction(()), str(error)
    scores = score_pair(truth, prediction, rules)
    return PairResult(name, summarise([scores], rules), problem), scores


def _prediction_in(folder: Path) -> Prediction:
    path = find_prediction(folder)
    if path is None:
        raise InputError(f"{folder} holds neither changes.json nor object_masks.pkl.")
    return read_prediction(path)


def _strangers(pred_root: Path, gt_root: Path) -> list[str]:
    """Predicted pairs that the benchmark does not know, perhaps by a slip in a name."""
    known = _annotated(gt_root)
    found = (p.name for p in pred_root.iterdir() if find_prediction(p) is not None)
    return sorted(name for name in found if name not in known)


def find_pairs(
    root: Path, split: Split | None = None, subset: Subset | None = None
) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """Folders of the annotated pairs under a benchmark's root, and warnings.

    Pairs come in the order of the split files where there are any (equal confidences make the
    order matter), then by name.

    Raises
    ------
    InputError
        No pair is there, or a split is asked for that no file lists.
    """
    if not root.is_dir():
        raise InputError(f"{root} is not a folder: give the folder that holds the truth.")
    present = _annotated(root)
    listed = _listed_pairs(root, split, subset)
    absent = [name for name in listed if name not in present]
    folders = [present[name] for name in listed if name in present]
    if split is None and subset is None:
        folders += [path for name, path in present.items() if name not in listed]
    if not folders:
        raise InputError(f"{root} holds no <pair>/segments.json or <pair>/segments.pkl to score.")
    lost = f"Pairs of the split files without a truth in {root}, not scored: {len(absent)}."
    return tuple(folders), (lost,) if absent else ()


def _annotated(root: Path) -> dict[str, Path]:
    """Folders that hold a truth, by name."""
    data = root / "data" if (root / "data").is_dir() else root
    return {
        folder.name: folder
        for folder in sorted(data.iterdir())
        if any(path.is_file() for path in annotation_files(folder))
    }


def _listed_pairs(root: Path, split: Split | None, subset: Subset | None) -> list[str]:
    names: list[str] = []
    for each in SPLITS if split is None else (split,):
        path = root / "splits" / f"{each}_split.json"
        if path.is_file():
            names += _names_in(path, SUBSETS if subset is None else (subset,))
        elif split is not None or subset is not None:
            raise InputError(f"{path} is missing: without it no pair is known to be in '{each}'.")
    return list(dict.fromkeys(names))


def _names_in(path: Path, subsets: Sequence[str]) -> list[str]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        names = [name for subset in subsets for name in content[subset]]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{path} is not a split file with lists {', '.join(subsets)}.") from error
    if not all(isinstance(name, str) for name in names):
        raise InputError(f"{path} lists something that is not a pair's name.")
    return names
