"""Derive how a change score becomes a confidence, and check it.

``python -m data_tools.benchmarks.calibration RESULTS PAIRS`` reads the results of rendered pairs
(``RESULTS/<pair>/changes.json``, as ``data_tools.benchmarks.synthetic`` writes them), asks which of
their objects are right, fits `ConfidenceConfig` by logistic regression and prints it beside the
reliability of the confidence that the results hold.
"""

import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from jaxtyping import Bool, Float, Float64
from scipy.optimize import minimize

from scenediff_classic.change.describe import FULL, ConfidenceConfig, looks
from scenediff_classic.dataset import read_annotations, read_prediction
from scenediff_classic.errors import SceneDiffError
from scenediff_classic.evaluation.benchmark import find_pairs
from scenediff_classic.evaluation.calibration import reliability
from scenediff_classic.evaluation.pairs import score_pair
from scenediff_classic.evaluation.rules import rules_of
from scenediff_classic.pipeline import DetectConfig
from scenediff_classic.result import read_result
from scenediff_classic.types import ChangedObject, Video

_RIDGE = 0.2
"""Keeps few objects from giving certainty."""


def inputs(
    item: ChangedObject, placed: Mapping[Video, int], config: ConfidenceConfig
) -> tuple[float, float]:
    """(change score, `looks` at it), each the mean over the captures that hold it.

    `placed` counts each capture's frames with a camera. The score is read back from the confidence
    of its views, which `config` made.
    """
    shown: Counter[Video] = Counter(v.video for v in item.views)
    seen = {video: looks(frames, placed[video]) for video, frames in shown.items()}
    odds = [np.log(v.confidence / (1 - v.confidence)) for v in item.views]
    doublings = [np.log2(seen[v.video]) for v in item.views]
    evidence = np.mean(odds) - config.base - config.per_doubling * np.mean(doublings)
    return float(evidence / config.per_score), float(np.mean([*seen.values()]))


def fit(
    score: Float[np.ndarray, "n"], seen: Float[np.ndarray, "n"], right: Bool[np.ndarray, "n"]
) -> ConfidenceConfig:
    """Logistic regression with a small ridge on the two slopes (at unit spread)."""
    features = np.c_[np.ones(len(score)), score / 0.2, np.log2(seen)]
    sign = np.where(right, 1.0, -1.0)

    def loss(weights: Float64[np.ndarray, "3"]) -> float:
        likelihood = np.logaddexp(0, -sign * (features @ weights)).sum()
        return float(likelihood + _RIDGE * np.sum(weights[1:] ** 2))

    base, per_score, per_doubling = minimize(loss, np.zeros(3)).x
    return ConfidenceConfig(float(base), float(per_score / 0.2), float(per_doubling))


@dataclass(frozen=True)
class Calibration:
    """Fit the confidence of changes to what turned out right."""

    results: tyro.conf.Positional[Path]
    """Folder of results by pair."""
    pairs: tyro.conf.Positional[Path]
    """Folder of rendered pairs."""

    def __call__(self) -> ConfidenceConfig:
        """Print the fitted constants, and how reliable confidence is as it stands and as fitted."""
        rows, now = [], DetectConfig().confidence
        folders, _ = find_pairs(self.pairs)
        for folder in folders:
            path = self.results / folder.name / "changes.json"
            judged = score_pair(read_annotations(folder), read_prediction(path), rules_of("strict"))
            result = read_result(path)
            placed: dict[Video, int] = {
                "before": sum(f.registered for f in result.before.frames),
                "after": sum(f.registered for f in result.after.frames),
            }
            ranked = sorted(result.objects, key=lambda o: -o.confidence)
            for item, right in zip(ranked, judged.objects.hit, strict=True):
                rows.append((item.confidence, *inputs(item, placed, now), right))
        confidence, score, seen, hit = np.array(rows, float).T
        right = hit > 0
        fitted = fit(score, seen, right)
        refit = np.array([fitted(s, FULL * n, FULL) for s, n in zip(score, seen, strict=True)])
        for name, trust in (("as it stands", confidence), ("as fitted", refit)):
            diagram = reliability(trust, right, bins=5)
            print(f"{name}: {len(trust)} objects, expected calibration error {diagram.error:.3f}")
            print(*diagram.rows(), sep="\n")
        print(fitted)
        return fitted


if __name__ == "__main__":
    try:
        tyro.cli(Calibration)()
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
