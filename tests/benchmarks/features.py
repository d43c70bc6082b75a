"""How well features tell changed surfaces from unchanged ones, and objects from each other.

``python -m tests.benchmarks.features PAIR... [--names NAME...] [--views 6]`` judges feature
back-ends alone, on rendered pairs (folders that ``data_tools.synthetic_pairs`` wrote) with their
true cameras, depth and objects. It prints a table per back-end and the constants that follow:
`similarity` and `merge`.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import pytest
import tyro
from jaxtyping import Bool, Float, Float32

from data_tools.benchmarks.rendered_truth import CHANGED
from scenediff_classic.cameras import camera_centre
from scenediff_classic.change.changed_regions import ObjectConfig
from scenediff_classic.change.moves import MoveConfig, size_of
from scenediff_classic.change.objects import SceneObject, similarity
from scenediff_classic.change.scoring import ScoringConfig, feature_distance
from scenediff_classic.change.visibility import (
    Comparable,
    VisibilityConfig,
    depth_edges,
    reproject,
)
from scenediff_classic.features.named import FEATURES
from scenediff_classic.protocols import FeatureExtractor
from scenediff_classic.types import VIDEOS, View
from tests.benchmarks.rendered_objects import (
    RenderedPair,
    neighbouring_regions,
    read_rendered_pair,
    rendered_pair,
    seen_objects,
)
from tests.plane_scene import BOOK, CLOCK, VASE, scene

WIDE = np.deg2rad(25)
"""Angle between two viewing rays from which viewpoints count as wide apart."""

EDGE_PX = 6
"""Pixels nearer than this to a depth edge count as near a silhouette."""


@dataclass
class Separation:
    """Distances of unchanged and of changed pixels, as two histograms of constant size."""

    counts: Float[np.ndarray, "2 bins"] = field(default_factory=lambda: np.zeros((2, 4000)))

    def add(self, distance: Float32[np.ndarray, "n"], changed: Bool[np.ndarray, "n"]) -> None:
        """Count pixels; distances run from 0 to 2."""
        bins = self.counts.shape[1]
        number = np.clip((distance * (bins / 2)).astype(int), 0, bins - 1)
        for k in (0, 1):
            self.counts[k] += np.bincount(number[changed == k], minlength=bins)

    def auc(self) -> float:
        """Chance that a changed pixel is farther than an unchanged one; NaN without either."""
        unchanged, changed = self.counts
        total = unchanged.sum() * changed.sum()
        below = np.cumsum(unchanged) - unchanged / 2  # equal distances count half
        return float(changed @ below / total) if total else np.nan


def best_threshold(same: Sequence[float], different: Sequence[float]) -> tuple[float, float]:
    """Middle of the values that separate best, and the mean of both shares of right answers.

    Every value above the threshold is taken for `same`.
    """
    values = np.unique([*same, *different])
    cuts = (values[1:] + values[:-1]) / 2
    if not len(same) or not len(different) or not len(cuts):
        return np.nan, np.nan
    right = [(np.mean(np.array(same) > c) + np.mean(np.array(different) <= c)) / 2 for c in cuts]
    best = np.flatnonzero(np.isclose(right, np.max(right)))
    return float(np.median(cuts[best])), float(np.max(right))


@dataclass
class Pairings:
    """Similarities of pairs that are, and that are not, one object."""

    same: list[float] = field(default_factory=list)
    different: list[float] = field(default_factory=list)

    def add(self, is_same: bool, value: float) -> None:
        """Keep one value."""
        (self.same if is_same else self.different).append(value)


@dataclass(frozen=True)
class Figures:
    """One row of the table: areas under the curve and rank 1 in percent."""

    raw: float
    """All mutually visible pixels, pictures as they are."""
    equalised: float
    """The same after `change.harmonise`, as are all that follow."""
    wide: float
    """Viewing rays at least 25 degrees apart."""
    edge: float
    """Within 6 pixels of a depth edge."""
    rank_1: float
    """Moved objects whose nearest object in the other capture is themselves."""
    cpu_ms: float
    """A frame."""
    channels: float

    def __str__(self) -> str:
        """One row of the table."""
        shown = (f"{100 * v:6.1f}" for v in (self.raw, self.equalised, self.wide, self.edge))
        return (
            f"{' '.join(shown)}  {100 * self.rank_1:6.1f}  {self.cpu_ms:6.0f} {self.channels:5.0f}"
        )


HEADER = "                        AUC: raw  equal   wide   edge  rank-1  CPU ms  channels"


def measure(
    features: FeatureExtractor, pair: RenderedPair, views: int, moves: Pairings, merges: Pairings
) -> Figures:
    """The figures of one pair; what tells objects apart is added to `moves` and `merges`."""
    chosen = pair.some(views)
    wanted = sorted({k for both in chosen for k in both})
    raw = {k: features(pair.raw.views[k]) for k in wanted}
    started = time.process_time()
    grids = {k: features(pair.equalised.views[k]) for k in wanted}
    cpu_ms = 1000 * (time.process_time() - started) / len(wanted)
    areas = _separations(pair, chosen, raw, grids)
    before, after = (seen_objects(pair, grids, video) for video in VIDEOS)
    rank_1 = _retrieve(pair, before, after, moves)
    barely = replace(ObjectConfig(), min_overlap=1e-6)
    for objects in (before, after):
        for is_same, a, b in neighbouring_regions(objects):
            value = similarity([a], [b], barely)
            if np.isfinite(value):  # they touch
                merges.add(is_same, value)
    channels = next(iter(grids.values())).shape[-1]
    return Figures(*areas, rank_1, cpu_ms, channels)


def _separations(
    pair: RenderedPair,
    chosen: Sequence[tuple[int, int]],
    raw: dict[int, np.ndarray],
    grids: dict[int, np.ndarray],
) -> tuple[float, ...]:
    visibility, shift = VisibilityConfig(), ScoringConfig().shift_cells
    prepared = {k: Comparable.of(pair.raw.views[k], visibility) for k in grids}
    changed_ids = [number for number, kind in pair.kinds.items() if kind in CHANGED]
    found = [Separation() for _ in range(4)]
    for i, j in chosen:
        for a, b in ((i, j), (j, i)):
            seen = reproject(prepared[a], prepared[b], visibility)
            rows, cols = np.nonzero(seen.visible)
            x, y = seen.xy[rows, cols].astype(int).T
            here, there = pair.instances[a][rows, cols], pair.instances[b][y, x]
            changed = np.isin(here, changed_ids) & (here != there)
            touches = np.isin(here, changed_ids) | np.isin(there, changed_ids)
            gap = np.abs(seen.gap[rows, cols])
            unchanged = ~touches & (here == there) & (gap < visibility.agreement)
            use = changed | unchanged
            points = prepared[a].points[rows, cols]
            wide = _angles(points, pair, a, b) >= WIDE
            edge = _near_edges(pair.raw.views[a].depth, visibility)[rows, cols]
            before_light, distance = (
                feature_distance(g[a], g[b], seen, pair.raw.views[b], shift)[rows, cols]
                for g in (raw, grids)
            )
            for separation, values, where in (
                (found[0], before_light, use),
                (found[1], distance, use),
                (found[2], distance, use & wide),
                (found[3], distance, use & edge),
            ):
                kept = where & np.isfinite(values)
                separation.add(values[kept], changed[kept])
    return tuple(s.auc() for s in found)


def _angles(points: np.ndarray, pair: RenderedPair, a: int, b: int) -> np.ndarray:
    """Radians between the rays to the points from the two cameras."""
    rays = [points - camera_centre(pair.raw.views[k].cam_from_world) for k in (a, b)]
    one, other = (r / np.linalg.norm(r, axis=-1, keepdims=True) for r in rays)
    return np.arccos(np.clip((one * other).sum(axis=-1), -1, 1))


def _near_edges(depth: np.ndarray, visibility: VisibilityConfig) -> np.ndarray:
    edges = depth_edges(depth, visibility.depth_edge).astype(np.uint8)
    return cv2.distanceTransform(1 - edges, cv2.DIST_L2, 5) <= EDGE_PX


def _retrieve(
    pair: RenderedPair,
    before: dict[int, SceneObject],
    after: dict[int, SceneObject],
    moves: Pairings,
) -> float:
    """Rank-1 accuracy of moved objects, both ways (NaN if none moved)."""
    hits = []
    for own, other in ((before, after), (after, before)):
        gallery = list(other)
        for number in own:
            if pair.kinds[number] == "moved" and number in other:
                cosines = [own[number].descriptor @ other[g].descriptor for g in gallery]
                hits.append(gallery[int(np.argmax(cosines))] == number)
    most = MoveConfig().max_size_ratio
    for one, a in before.items():
        for another, b in after.items():
            both = {pair.kinds[one], pair.kinds[another]}
            if "fixed" in both or (one == another and both != {"moved"}):
                continue  # what stayed agrees through its surroundings, too
            if one == another or max(size_of(a), size_of(b)) <= most * min(size_of(a), size_of(b)):
                moves.add(one == another, float(a.descriptor @ b.descriptor))
    return float(np.mean(hits)) if hits else np.nan


@dataclass(frozen=True)
class Options:
    """Feature back-ends alone, on rendered pairs with true geometry."""

    pairs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    names: tuple[str, ...] = tuple(FEATURES)
    views: int = 6
    """View pairs of each pair of captures."""


def main(options: Options) -> None:
    """Print a table and the constants of every back-end."""
    rows: dict[str, list[Figures]] = {name: [] for name in options.names}
    moves = {name: Pairings() for name in options.names}
    merges = {name: Pairings() for name in options.names}
    for folder in options.pairs:
        pair = read_rendered_pair(folder)
        print(f"{folder.name}\n{HEADER}")
        for name in options.names:
            features = FEATURES[name]
            figures = measure(features, pair, options.views, moves[name], merges[name])
            rows[name].append(figures)
            print(f"{name:>24}  {figures}", flush=True)
    print(f"mean\n{HEADER}")
    for name in options.names:
        table = np.array([[*vars(figures).values()] for figures in rows[name]])
        print(f"{name:>24}  {Figures(*np.nanmean(table, axis=0))}")
    print("\nconstants (share of right answers, mean of same and different objects)")
    for name in options.names:
        tau, right = best_threshold(moves[name].same, moves[name].different)
        sigma, sure = best_threshold(merges[name].same, merges[name].different)
        print(f"{name:>24}  similarity {tau:.3f} ({right:.1%})  merge {sigma:.3f} ({sure:.1%})")


def test_area_under_the_curve() -> None:
    near, far = Separation(), Separation()
    rng = np.random.default_rng(0)
    values, changed = rng.uniform(0, 1, 5000).astype(np.float32), rng.uniform(size=5000) < 0.3
    near.add(values, changed)
    assert near.auc() == pytest.approx(0.5, abs=0.03)
    far.add(values / 2 + changed.astype(np.float32), changed)
    assert far.auc() == pytest.approx(1)
    assert np.isnan(Separation().auc())
    tied = Separation()
    tied.add(np.full(4, 0.5, np.float32), np.array([True, False, True, False]))
    assert tied.auc() == pytest.approx(0.5)


def test_threshold_that_separates_best() -> None:
    cut, right = best_threshold([0.9, 0.95], [0.5, 0.7])
    assert (cut, right) == (pytest.approx(0.8), 1)
    cut, right = best_threshold([0.9, 0.3], [0.5, 0.7])
    assert 0.7 < cut < 0.9
    assert right == pytest.approx(0.75)
    assert np.isnan(best_threshold([0.9], [])[0])


class Knowing:
    """Reads the truth off the drawn cards' depth; `blind` sees no difference at all."""

    similarity, merge = 0.5, 1.4

    def __init__(self, blind: bool) -> None:
        self.blind = blind

    def __call__(self, view: View) -> np.ndarray:
        card = view.depth[2::4, 2::4] < np.nanmax(view.depth) - 0.1
        card = card & (not self.blind)
        return np.stack([~card, card], axis=-1).astype(np.float32)


@pytest.mark.parametrize("blind", [False, True])
def test_figures_of_a_drawn_pair(blind: bool) -> None:
    """A card vanishes and a card moves: who sees cards is right, and the blind is not."""
    geometry = scene([VASE, CLOCK], [BOOK])
    labels = tuple(_drawn(view) for view in geometry.views)
    pair = rendered_pair(geometry, labels, {1: "moved"})
    moves, merges = Pairings(), Pairings()
    figures = measure(Knowing(blind), pair, 2, moves, merges)
    assert figures.channels == 2
    assert figures.cpu_ms >= 0
    if blind:
        assert figures.equalised == pytest.approx(0.5, abs=0.02)
    else:
        assert figures.equalised > 0.9
        assert figures.rank_1 == 1
        assert moves.same == [pytest.approx(1, abs=0.05)]
    assert merges.same


def _drawn(view: View) -> np.ndarray:
    """Every card is a view of the one object 1."""
    return (view.depth < np.nanmax(view.depth) - 0.1).astype(np.int32)


if __name__ == "__main__":
    main(tyro.cli(Options))
