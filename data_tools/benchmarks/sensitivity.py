"""How the figures follow the method's weights and thresholds, one at a time, on rendered pairs.

``python -m data_tools.benchmarks.sensitivity PAIRS -o OUT`` writes ``OUT/sensitivity.csv``,
``.json``, ``.md`` and ``.png``. Only what an option decides is computed again: for most that is the
quick half of the method, for `tau_occ` the scores as well.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from data_tools.benchmarks.ablation import Ablation, GeometryName
from data_tools.benchmarks.row_plots import draw_curves
from data_tools.benchmarks.row_tables import rows_table, write_rows
from data_tools.benchmarks.rows import Judged, Row, judged_rows, with_option
from scenediff_classic.errors import InputError, SceneDiffError
from scenediff_classic.pipeline import DetectConfig
from scenediff_classic.presets import Preset


@dataclass(frozen=True)
class Sweep:
    """Values of one option."""

    symbol: str
    """The paper's, or our own name where the paper has no such thing."""
    option: str
    """Path in `DetectConfig`."""
    values: tuple[float, ...]

    def default(self, config: DetectConfig) -> float | None:
        """The value that the method has; None = it chooses one by itself."""
        value: Any = config
        for name in self.option.split("."):
            value = getattr(value, name)
        if self.option == "moves.similarity" and value is None:
            return config.features.similarity
        return None if value is None else float(value)


SWEEPS = (
    Sweep("lambda_geom", "scoring.geometry_weight", (0, 0.25, 0.5, 1, 1.5, 2, 3)),
    Sweep("lambda_feat", "scoring.feature_weight", (0.125, 0.25, 0.375, 0.5, 0.75, 1)),
    Sweep("lambda_region", "scoring.region_weight", (0, 0.05, 0.1, 0.2, 0.3, 0.5)),
    Sweep("tau_delta", "threshold.fixed", (0.08, 0.12, 0.16, 0.2, 0.25, 0.3, 0.4)),
    Sweep("sigma_merge", "features.merge", (0.8, 1.1, 1.3, 1.4, 1.5, 1.6, 1.8)),
    Sweep("tau_sim", "moves.similarity", (0.7, 0.8, 0.88, 0.93, 0.96, 0.98)),
    Sweep("tau_occ", "scoring.visibility.occlusion", (-0.005, -0.01, -0.02, -0.04, -0.08)),
    Sweep("sigma_geo", "objects.merge_radius", (0.0025, 0.005, 0.01, 0.02, 0.04)),
    Sweep("geometry noise", "scoring.geometry_noise", (0.0025, 0.005, 0.01, 0.02, 0.04)),
    Sweep("geometry scale", "scoring.geometry_scale", (3, 6, 12, 24)),
    Sweep("measured share", "scoring.measured_share", (0.3, 0.6, 1, 1.5)),
    Sweep("noise floor", "threshold.noise_floor", (0, 0.05, 0.08, 0.11, 0.14, 0.17)),
    Sweep("certain change", "threshold.certain", (0.15, 0.18, 0.22, 0.26, 0.32)),
    Sweep("least overlap", "objects.min_overlap", (0.0, 0.3, 0.5, 0.6, 0.7, 0.8)),
    Sweep("least agreement", "objects.min_agreement", (0.0, 0.5, 0.65, 0.75, 0.85, 0.95)),
    Sweep("enclosed", "objects.enclosed", (1.0, 1.5, 2.0, 2.5, 4.0)),
    Sweep("least feature", "objects.min_feature", (0.0, 0.04, 0.08, 0.12, 0.16)),
)
"""The supplement's weights and thresholds, then the method's own."""


@dataclass(frozen=True)
class Sensitivity:
    """Change one option at a time."""

    pairs: tyro.conf.Positional[Path]
    """Folder of rendered pairs."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for results."""
    work: Path | None = None
    """Folder for finished stages, by pair; OUT/work if left out. Commands may share it."""
    base: GeometryName = "patchmatch"
    """Where cameras and depth come from."""
    only: tuple[str, ...] = ()
    """Symbols of the options to change; all if left out."""
    preset: Preset = "balanced"
    """As in `scenediff-classic detect`."""

    def __call__(self) -> list[Judged]:
        """Run, judge, print, and write."""
        unknown = set(self.only) - {s.symbol for s in SWEEPS}
        if unknown:
            known = ", ".join(s.symbol for s in SWEEPS)
            raise InputError(f"There is no option {', '.join(sorted(unknown))}; there are {known}.")
        sweeps = [s for s in SWEEPS if not self.only or s.symbol in self.only]
        console = Console()
        method = Ablation(self.pairs, self.out, base=self.base, preset=self.preset)
        rows = list(_rows(method, sweeps))
        judged = judged_rows(rows, self.pairs, self.out, self.work or self.out / "work", console)
        console.print(rows_table(f"Sensitivity, {self.base} geometry (percent)", judged))
        config = method.configured(Path())
        defaults = {sweep.symbol: sweep.default(config) for sweep in sweeps}
        options = {sweep.symbol: sweep.option for sweep in sweeps}
        about = {"base": self.base, "preset": self.preset, "command": sys.argv}
        write_rows(judged, self.out / "sensitivity", **about, options=options, defaults=defaults)
        curves = {s.symbol: [j for j in judged if j.row.group == s.symbol] for s in sweeps}
        draw_curves(curves, defaults, judged[0], self.out / "sensitivity.png")
        return judged


def _rows(method: Ablation, sweeps: Sequence[Sweep]) -> Iterator[Row]:
    yield Row("as it is", "default", method.configured, workspace=method.base)
    for sweep in sweeps:
        default = sweep.default(method.configured(Path()))
        for value in sweep.values:
            if value != default:
                yield _row(method, sweep, value)


def _row(method: Ablation, sweep: Sweep, value: float) -> Row:
    def make(pair: Path) -> DetectConfig:
        return with_option(method.configured(pair), sweep.option, float(value))

    return Row(sweep.symbol, f"{value:g}", make, workspace=method.base)


if __name__ == "__main__":
    try:
        tyro.cli(Sensitivity)()
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
