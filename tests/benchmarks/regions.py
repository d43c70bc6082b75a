"""How well regions match the true objects of rendered captures, before anything is compared.

``python -m tests.benchmarks.regions PAIR... [--results RESULTS]`` prints one line a pair and
proposer: folders that ``data_tools.synthetic_pairs`` wrote, under true geometry or under that of
``RESULTS/<pair>``, where ``data_tools.benchmarks.synthetic`` or ``detect`` has left it.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import numpy as np
import pytest
import tyro
from jaxtyping import Bool

from data_tools.benchmarks.rendered_truth import RenderedTruth
from scenediff_classic.change.scale import normalised
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.geometry.known_cameras import KnownGeometry
from scenediff_classic.protocols import RegionProposer, silent
from scenediff_classic.regions.named import REGIONS, RegionName
from scenediff_classic.types import VIDEOS, Geometry, Regions, View
from tests.plane_scene import BOOK, VASE, render

Masks = tuple[Bool[np.ndarray, "h w"], ...]


def rendered_views(pair: Path, results: Path | None = None) -> tuple[Geometry, list[Masks]]:
    """Both captures of a rendered pair, and the visible pixels of what changed, by view.

    Parameters
    ----------
    results : Path, optional
        Where ``<pair>`` is a finished run of `detect`, whose geometry is taken; otherwise the
        true one.
    """
    source = KnownGeometry(pair / "truth_geometry.npz" if results is None else results / pair.name)
    before, after = (CaptureOptions(pair / video).read(video, silent) for video in VIDEOS)
    geometry = normalised(source(before, after, pair, silent))
    truth = RenderedTruth(pair)
    return geometry, [_masks(truth, view) for view in geometry.views]


def _masks(truth: RenderedTruth, view: View) -> Masks:
    """Objects of at least 100 pixels (of a picture with long side 518) as the view shows them."""
    seen = truth.instances(view)
    least = 100 * (max(view.shape) / 518) ** 2
    return tuple(mask for mask in (seen == k for k in truth.changed) if mask.sum() >= least)


@dataclass(frozen=True)
class Fit:
    """How well regions could show one object in one view."""

    whole: float
    """IoU of the best single region."""
    union: float
    """IoU of all regions together that lie in the object by more than half."""
    pieces: int
    """How many those are."""


def fit(regions: Regions, truth: Bool[np.ndarray, "h w"]) -> Fit:
    """Achievable IoU of an object."""
    labels = regions.labels
    inside = np.bincount(labels[truth & (labels >= 0)], minlength=regions.count)
    sizes = np.bincount(labels[labels >= 0], minlength=regions.count)
    area = int(truth.sum())
    mostly = inside > 0.5 * sizes
    covered, taken = int(inside[mostly].sum()), int(sizes[mostly].sum())
    whole = (inside / (sizes + area - inside)).max(initial=0.0)
    return Fit(float(whole), covered / (taken + area - covered), int(mostly.sum()))


@dataclass(frozen=True)
class Figures:
    """Means over the objects of all views; IoU in percent."""

    whole: float
    found: float
    """Objects whose best single region has an IoU above one half, in percent."""
    union: float
    pieces: float
    regions: float
    """Per frame."""
    seconds: float
    """Per frame."""

    def __str__(self) -> str:
        """One row of the table."""
        return (
            f"{self.whole:6.1f} {self.found:6.1f}  {self.union:6.1f} {self.pieces:6.2f}  "
            f"{self.regions:7.1f} {self.seconds:6.2f}"
        )


HEADER = f"{'':>26}  one: IoU  >50 %   union  pieces  regions   s"


def measure(proposer: RegionProposer, views: Sequence[View], truth: Sequence[Masks]) -> Figures:
    """The figures of one proposer; NaN where no view shows a changed object."""
    started = time.perf_counter()
    proposals = [proposer(view) for view in views]
    seconds = (time.perf_counter() - started) / len(views)
    fits = [fit(r, mask) for r, masks in zip(proposals, truth, strict=True) for mask in masks]
    rows = np.array([(f.whole, f.whole > 0.5, f.union, f.pieces) for f in fits]).reshape(-1, 4)
    whole, found, union, pieces = rows.mean(axis=0) if len(rows) else np.full(4, np.nan)
    count = float(np.mean([r.count for r in proposals]))
    return Figures(100 * whole, 100 * found, 100 * union, pieces, count, seconds)


@dataclass(frozen=True)
class Options:
    """Regions against the true objects of rendered captures."""

    pairs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    results: Path | None = None
    """Folder of finished runs with estimated geometry; left out: true geometry."""
    regions: tuple[RegionName, ...] = get_args(RegionName)


def main(options: Options) -> None:
    """Print the table."""
    print(HEADER)
    rows: dict[str, list[list[float]]] = {name: [] for name in options.regions}
    for pair in options.pairs:
        geometry, truth = rendered_views(pair, options.results)
        for name in options.regions:
            figures = measure(REGIONS[name], geometry.views, truth)
            print(f"{pair.name:>9} {name:>16}  {figures}", flush=True)
            rows[name].append([*vars(figures).values()])
    for name, values in rows.items():
        print(f"{'mean':>9} {name:>16}  {Figures(*np.nanmean(values, axis=0))}")


def test_figures_of_drawn_regions() -> None:
    """An object of 4 x 4 pixels in two halves, one of which spills over by two pixels."""
    labels = np.zeros((10, 10), np.int32)
    labels[2:6, 2:4] = 1  # 8 pixels, all inside
    labels[2:6, 4:6] = 2  # 8 inside
    labels[6, 4:6] = 2  # 2 outside
    labels[9] = -1
    truth = np.zeros((10, 10), bool)
    truth[2:6, 2:6] = True
    found = fit(Regions(labels, 3), truth)
    assert found == Fit(whole=0.5, union=16 / 18, pieces=2)
    nothing = fit(Regions(np.full((10, 10), -1, np.int32), 0), truth)
    assert nothing == Fit(whole=0.0, union=0.0, pieces=0)


def test_means_over_objects_and_frames() -> None:
    """One view has its card in one region; the other's regions are the picture's halves."""
    view = render([VASE, BOOK], "before", 0, (0.0, 0.0, 0.0))
    card = view.depth == np.float32(VASE.z)
    halves = np.repeat([0, 1], view.shape[1] // 2)[None].repeat(view.shape[0], 0).astype(np.int32)
    answers = iter((Regions(card.astype(np.int32), 2), Regions(halves, 2)))
    left = halves == 0
    quarter = left & (np.arange(view.shape[0]) < view.shape[0] // 2)[:, None]
    figures = measure(lambda _: next(answers), [view, view], [(card,), (left, quarter)])
    assert figures.whole == pytest.approx(100 * (1 + 1 + 0.5) / 3, abs=1)
    assert figures.found == pytest.approx(200 / 3)
    assert figures.union == pytest.approx(200 / 3)
    assert figures.pieces == pytest.approx(2 / 3)
    assert figures.regions == 2


def test_nothing_changed_has_no_figures() -> None:
    view = render([VASE], "before", 0, (0.0, 0.0, 0.0))
    figures = measure(lambda v: Regions(np.zeros(v.shape, np.int32), 1), [view], [()])
    assert np.isnan(figures.whole)
    assert figures.regions == 1


if __name__ == "__main__":
    main(tyro.cli(Options))
