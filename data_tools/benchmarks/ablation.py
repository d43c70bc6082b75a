"""Which part of the method carries how much, on rendered pairs.

``python -m data_tools.benchmarks.ablation PAIRS -o OUT`` leaves out cues of the score, and swaps
back-ends of features, regions and geometry; ``--oracles`` also puts the truth in place of one stage
at a time. It writes ``OUT/ablation.csv``, ``.json``, ``.md`` and ``.png``.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro
from rich.console import Console

from data_tools.benchmarks.oracles import (
    Depth,
    MixedGeometry,
    TrueAssociation,
    TrueFeatures,
    TrueRegions,
    TrueScores,
)
from data_tools.benchmarks.rendered_truth import RenderedTruth
from data_tools.benchmarks.row_plots import draw_rows
from data_tools.benchmarks.row_tables import rows_table, write_rows
from data_tools.benchmarks.rows import AsEver, Judged, Row, Rule, best_variants, judged_rows
from scenediff_classic.errors import SceneDiffError
from scenediff_classic.features.named import FeatureName
from scenediff_classic.pipeline import DetectConfig
from scenediff_classic.presets import LONG_SIDE, Preset, configured
from scenediff_classic.regions.named import RegionName

GeometryName = Literal["patchmatch", "plane-sweep", "true"]

CUES = {"E_g": "geometry_weight", "E_f": "feature_weight", "E_r": "region_weight"}
"""The paper's cues -> their weights in `ScoringConfig`."""
SETS = ("E_g", "E_f", "E_r", "E_g + E_f", "E_g + E_r", "E_f + E_r")

LIMITS = (1.0, 0.5, 0.2)
"""Factors of the bounds of the change threshold that a part of the cues is tried with: less cues
make a smaller sum, and the bounds were chosen for all of them. The best one by obj/im AP counts."""


@dataclass(frozen=True)
class Ablation:
    """Leave parts of the method out, or replace them, one at a time."""

    pairs: tyro.conf.Positional[Path]
    """Folder of rendered pairs."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for results."""
    work: Path | None = None
    """Folder for finished stages, by pair; OUT/work if left out. Commands may share it."""
    base: GeometryName = "patchmatch"
    """Geometry under which everything else is compared."""
    cues: bool = True
    """Rows with a part of the cues of the score."""
    features: tuple[FeatureName, ...] = get_args(FeatureName)
    """Rows with other features."""
    regions: tuple[RegionName, ...] = get_args(RegionName)
    """Rows with other regions."""
    geometry: tuple[GeometryName, ...] = get_args(GeometryName)
    """Rows with another geometry."""
    oracles: bool = False
    """Rows with the truth in place of one stage."""
    only: tuple[str, ...] = ()
    """Names of the rows to do beside the first; all if left out."""
    preset: Preset = "balanced"
    """As in `scenediff-classic detect`."""

    def __call__(self) -> list[Judged]:
        """Run, judge, print, and write."""
        console = Console()
        first, *others = self.rows()
        rows = [first, *(r for r in others if not self.only or r.name in self.only)]
        judged = judged_rows(rows, self.pairs, self.out, self.work or self.out / "work", console)
        shown = best_variants(judged)
        console.print(rows_table(f"Ablation, {self.base} geometry (percent)", shown))
        about = {"base": self.base, "preset": self.preset, "command": sys.argv}
        write_rows(shown, self.out / "ablation", **about)
        write_rows(judged, self.out / "ablation_all", **about)
        draw_rows(shown, self.out / "ablation.png")
        return judged

    def rows(self) -> Iterator[Row]:
        """The method as it is first, then group by group."""
        default = self.configured(Path())
        yield self._row("as it is", "all cues")
        for name in SETS if self.cues else ():
            for factor in LIMITS:
                variant = "" if factor == 1 else f"x{factor:g}"
                yield self._row("cues", name, only_cues(name, factor), variant=variant)
        for feature in self.features:
            if configured(features=feature).features != default.features:
                yield self._row("features", feature, _with_features(feature))
        for region in self.regions:
            if configured(regions=region).regions != default.regions:
                yield self._row("regions", region, _with_regions(region))
        for source in self.geometry:
            if source != self.base:
                yield Row("geometry", source, self._geometry(source), workspace=source)
        if self.oracles:
            yield from self._oracles()

    def configured(self, pair: Path) -> DetectConfig:
        """The method as it is."""
        return self._geometry(self.base)(pair)

    def _geometry(self, source: GeometryName) -> Callable[[Path], DetectConfig]:
        def make(pair: Path) -> DetectConfig:
            if source == "true":
                return configured(self.preset, geometry=pair / "truth_geometry.npz")
            return configured(self.preset, stereo=source)

        return make

    def _row(
        self,
        group: str,
        name: str,
        changed: Callable[[DetectConfig, Path], DetectConfig] = lambda config, pair: config,
        rule: Callable[[Path], Rule] = lambda pair: AsEver(),
        variant: str = "",
    ) -> Row:
        """A row with the base's geometry."""

        def make(pair: Path) -> DetectConfig:
            return changed(self.configured(pair), pair)

        return Row(group, name, make, rule, self.base, variant)

    def _oracles(self) -> Iterator[Row]:
        def mixed(cameras: Literal["estimated", "true"], depth: Depth = "estimated"):
            def change(config: DetectConfig, pair: Path) -> DetectConfig:
                truth, side = pair / "truth_geometry.npz", LONG_SIDE[self.preset]
                source = MixedGeometry(config.geometry, truth, cameras, depth, side)
                return replace(config, geometry=source)

            return change

        def true_regions(config: DetectConfig, pair: Path) -> DetectConfig:
            return replace(config, regions=TrueRegions(RenderedTruth(pair), config.regions))

        def true_features(config: DetectConfig, pair: Path) -> DetectConfig:
            return replace(config, features=TrueFeatures(RenderedTruth(pair)))

        def true_scores(pair: Path) -> Rule:
            return TrueScores(RenderedTruth(pair))

        def true_groups(pair: Path) -> Rule:
            return TrueAssociation(RenderedTruth(pair))

        def true_groups_and_moves(pair: Path) -> Rule:
            return TrueAssociation(RenderedTruth(pair), moves=True)

        group = "one stage true"
        yield self._row(group, "regions", true_regions)
        yield self._row(group, "features", true_features)
        yield self._row(group, "scores", rule=true_scores)
        yield self._row(group, "association", rule=true_groups)
        yield self._row(group, "association, status", rule=true_groups_and_moves)
        if self.base == "true":
            return
        group = "geometry partly true"
        yield self._row(group, "cameras", mixed("true"))
        yield self._row(group, "depth", mixed("estimated", "true"))
        yield self._row(group, "depth where found", mixed("estimated", "true where found"))
        yield self._row(group, "depth where missing", mixed("estimated", "true where missing"))


def only_cues(names: str, factor: float) -> Callable[[DetectConfig, Path], DetectConfig]:
    """Only some cues of the score: the others have no weight, and no rule asks for them."""

    def change(config: DetectConfig, pair: Path) -> DetectConfig:
        kept = names.split(" + ")
        off = {weight: 0.0 for cue, weight in CUES.items() if cue not in kept}
        least, limits = config.objects.min_feature, config.threshold
        return replace(
            config,
            scoring=replace(config.scoring, **off),
            objects=replace(config.objects, min_feature=least if "E_f" in kept else 0.0),
            threshold=replace(
                limits, noise_floor=factor * limits.floor, certain=factor * limits.certain
            ),
        )

    return change


def _with_features(name: FeatureName) -> Callable[[DetectConfig, Path], DetectConfig]:
    return lambda config, pair: replace(config, features=configured(features=name).features)


def _with_regions(name: RegionName) -> Callable[[DetectConfig, Path], DetectConfig]:
    return lambda config, pair: replace(config, regions=configured(regions=name).regions)


if __name__ == "__main__":
    try:
        tyro.cli(Ablation)()
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
