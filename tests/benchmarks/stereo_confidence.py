"""Fit how likely a depth is right from what confirms it (`ConfidenceWeights` of a matcher).

``python -m tests.benchmarks.stereo_confidence PAIR... [--stereo plane-sweep]`` takes the
captures of rendered pairs with true cameras and depth, fits the weights by logistic regression on
every other pair, and prints on the rest how reliable the confidence is as it stands and as fitted,
and how often the 84 % of which stereo is surest are right.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
import tyro
from jaxtyping import Bool, Float, Float64
from scipy.optimize import minimize

from scenediff_classic.evaluation.calibration import reliability
from scenediff_classic.geometry.stereo.depth_confidence import (
    RIGHT,
    ConfidenceWeights,
    roughness,
)
from scenediff_classic.geometry.stereo.multi_view import MultiViewStereo, StereoWork
from scenediff_classic.geometry.stereo.patchmatch import PatchMatch
from scenediff_classic.geometry.stereo.plane_sweep import PlaneSweep
from scenediff_classic.presets import StereoMethod
from scenediff_classic.protocols import silent
from scenediff_classic.types import VIDEOS, Geometry
from tests.benchmarks.stereo import Truth, rendered_capture
from tests.geometry.textured_room import room

STRIDE = 5
"""One pixel of so many is used to fit."""
SHARE = 0.84
"""Of the pixels of which stereo is surest, as in `tests.benchmarks.stereo`."""


@dataclass(frozen=True)
class Evidence:
    """What is known of each pixel with found and with true depth."""

    supporters: Float[np.ndarray, "n"]
    cost: Float[np.ndarray, "n"]
    rough: Float[np.ndarray, "n"]
    right: Bool[np.ndarray, "n"]

    @staticmethod
    def of(
        stereo: MultiViewStereo, geometry: Geometry, truth: Truth, neighbourhood: int = 1
    ) -> "Evidence":
        """Run both passes of stereo."""
        with tempfile.TemporaryDirectory() as folder:
            work = StereoWork.of(stereo, geometry, Path(folder), silent)
            found = work.second_pass(work.first_pass())
            columns = []
            for i, (view, true) in enumerate(zip(found, truth, strict=True)):
                known = np.isfinite(true) & np.isfinite(view.depth)
                _, supporters = work.confidence(i, found)
                error = np.abs(view.depth[known] / true[known] - 1)
                maps = (supporters, work.cost(i), roughness(view.depth, neighbourhood))
                columns.append((*(m[known].astype(float) for m in maps), error < RIGHT))
        return Evidence(*(np.concatenate(c) for c in zip(*columns, strict=True)))

    @staticmethod
    def joined(parts: "list[Evidence]") -> "Evidence":
        """All pixels of several captures."""
        return Evidence(
            *(np.concatenate([vars(part)[name] for part in parts]) for name in vars(parts[0]))
        )

    def confidence(self, weights: ConfidenceWeights) -> Float64[np.ndarray, "n"]:
        """How likely each is right."""
        return weights(self.supporters, self.cost, self.rough)


def fit(evidence: Evidence, neighbourhood: int = 1) -> ConfidenceWeights:
    """Logistic regression."""
    features = np.c_[
        np.ones(len(evidence.cost)), np.log2(1 + evidence.supporters), evidence.cost, evidence.rough
    ][::STRIDE]
    sign = np.where(evidence.right[::STRIDE], 1.0, -1.0)

    def loss(weights: Float64[np.ndarray, "4"]) -> tuple[float, Float64[np.ndarray, "4"]]:
        margin = sign * (features @ weights)
        slope = -sign / (1 + np.exp(np.minimum(margin, 500)))
        return float(np.logaddexp(0, -margin).mean()), features.T @ slope / len(sign)

    found = minimize(loss, np.zeros(4), jac=True).x
    return ConfidenceWeights(*map(float, found), neighbourhood)


def surest(evidence: Evidence, weights: ConfidenceWeights) -> float:
    """Share of the surest `SHARE` of the pixels that is right."""
    order = np.argsort(-evidence.confidence(weights), kind="stable")
    return float(evidence.right[order[: int(SHARE * len(order))]].mean())


@dataclass(frozen=True)
class Options:
    """Fit and check the confidence of stereo."""

    pairs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    width: int = 320
    stereo: StereoMethod = "patchmatch"
    sources: int = 4
    neighbourhood: int | None = None
    """Side of the square over which roughness is averaged; the matcher's own if left out."""


def main(options: Options) -> None:
    """Fit on every other pair, print the check on the rest, and the weights fitted on all."""
    matcher = {"patchmatch": PatchMatch, "plane-sweep": PlaneSweep}[options.stereo]()
    side = options.neighbourhood or matcher.confidence_weights.neighbourhood
    stereo, evidence = MultiViewStereo(matcher, sources=options.sources), []
    for pair in options.pairs:
        captures = (rendered_capture(pair, video, options.width) for video in VIDEOS)
        evidence.append(Evidence.joined([Evidence.of(stereo, *c, side) for c in captures]))
        print(f"{pair.name}: {len(evidence[-1].right)} pixels", flush=True)
    seen, unseen = Evidence.joined(evidence[::2]), evidence[1::2]
    current = matcher.confidence_weights
    checked = {"as fitted on the others": fit(seen, side)}
    if side == current.neighbourhood:
        checked = {"as it stands": current, **checked}
    for name, weights in checked.items():
        print(f"\n{name}: {weights}")
        for pair, part in zip(options.pairs[1::2], unseen, strict=True):
            error = reliability(part.confidence(weights), part.right).error
            print(
                f"{pair.name:>16}  surest {SHARE:.0%} right {100 * surest(part, weights):.2f} %, "
                f"calibration error {error:.3f}"
            )
        joined = Evidence.joined(unseen)
        print(*reliability(joined.confidence(weights), joined.right).rows(), sep="\n")
    print(f"\nfitted on all: {fit(Evidence.joined(evidence), side)}")


def test_weights_are_found_again() -> None:
    rng = np.random.default_rng(0)
    true = ConfidenceWeights(2.0, 1.0, -3.0, -1.5)
    supporters = rng.integers(0, 5, 60000).astype(float)
    cost, rough = rng.random(60000), 3 * rng.random(60000)
    right = rng.random(60000) < true(supporters, cost, rough)
    found = fit(Evidence(supporters, cost, rough, right))
    assert list(vars(found).values()) == pytest.approx(list(vars(true).values()), abs=0.15)


@pytest.mark.slow
def test_fitted_weights_tell_right_from_wrong() -> None:
    evidence = Evidence.of(MultiViewStereo(), *room(height=96, width=128, count=5))
    weights = fit(evidence)
    assert surest(evidence, weights) > evidence.right.mean()
    assert weights.per_roughness < 0


if __name__ == "__main__":
    main(tyro.cli(Options))
