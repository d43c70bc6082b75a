"""Score the method on rendered pairs, with estimated and with true geometry.

``python -m data_tools.benchmarks.synthetic PAIRS -o OUT`` runs every pair under PAIRS (made by
``python -m data_tools.synthetic_pairs``) both ways and prints the metrics side by side: the
difference is what classical geometry costs. Finished pairs are kept, so a killed run continues.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Table

from data_tools.benchmarks.row_tables import metrics_table, numbers, percent
from data_tools.benchmarks.rows import rendered_pairs
from scenediff_classic.detection_run import CaptureOptions, run_detection
from scenediff_classic.errors import SceneDiffError
from scenediff_classic.evaluation.benchmark import EvaluationResult, evaluate
from scenediff_classic.evaluation.calibration import reliability
from scenediff_classic.evaluation.tables import pair_table
from scenediff_classic.pipeline import detect_changes
from scenediff_classic.presets import Preset, configured
from scenediff_classic.regions.named import RegionName
from scenediff_classic.workspace import write_atomic

GeometrySource = Literal["estimated", "true"]


@dataclass(frozen=True)
class SyntheticBenchmark:
    """Run and score every rendered pair."""

    pairs: tyro.conf.Positional[Path]
    """Folder of rendered pairs."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for results: OUT/<geometry>/<pair>, and OUT/metrics.json."""
    geometry: tuple[GeometrySource, ...] = ("true", "estimated")
    """Where cameras and depth come from."""
    preset: Preset = "balanced"
    """As in `scenediff-classic detect`."""
    regions: RegionName = "boundary-merging"
    """As in `scenediff-classic detect`."""
    overwrite: bool = False
    """Replace results of other options."""

    def __call__(self) -> dict[GeometrySource, EvaluationResult]:
        """Detect, evaluate in strict mode, print, and write ``metrics.json``."""
        folders = rendered_pairs(self.pairs)
        console = Console()
        results = {}
        for source in self.geometry:
            for folder in folders:
                console.print(f"{source} geometry: {folder.name}")
                try:
                    self._detect(folder, source)
                except SceneDiffError as error:  # counts as all missed in strict mode
                    console.print(f"  failed: {error}")
            (self.out / source).mkdir(parents=True, exist_ok=True)
            results[source] = evaluate(self.out / source, self.pairs)
            console.print(pair_table(results[source]))
            console.print(_by_hard_case(results[source], folders))
            console.print(_reliability(source, results[source]))
        console.print(_side_by_side(results))
        content = {s: numbers(r.metrics) for s, r in results.items()}
        write_atomic(self.out / "metrics.json", json.dumps(content, indent=2) + "\n")
        return results

    def _detect(self, folder: Path, source: GeometrySource) -> None:
        truth = folder / "truth_geometry.npz" if source == "true" else None
        config = configured(self.preset, geometry=truth, regions=self.regions)
        run_detection(
            CaptureOptions(folder / "before"),
            CaptureOptions(folder / "after"),
            self.out / source / folder.name,
            lambda before, after, workspace, progress: detect_changes(
                before, after, config, workspace=workspace, progress=progress
            ),
            config,
            uses=() if truth is None else (truth,),
            overwrite=self.overwrite,
            command=tuple(sys.argv),
        )


def _by_hard_case(result: EvaluationResult, folders: Sequence[Path]) -> Table:
    """The pairs again, with what makes each of them hard."""
    table = Table(title="Hard cases (percent)")
    for name in ("hard case", "pair", "px/im IoU", "obj/im AP", "obj/sc AP", "found", "others"):
        table.add_column(name, justify="left" if name in ("hard case", "pair") else "right")
    rows = {row.pair: row.metrics for row in result.pairs}
    for folder in folders:
        metadata = json.loads((folder / "metadata.json").read_text(encoding="utf-8"))
        case, m = ", ".join(metadata.get("hard", [])) or "none", rows.get(folder.name)
        if m is not None:
            figures = (m.px_im_iou, m.obj_im_ap, m.obj_sc_ap)
            table.add_row(
                case, folder.name, *(percent(v) for v in figures),
                f"{m.found_objects} of {m.true_objects}",
                str(m.reported_objects - m.found_objects),
            )  # fmt: skip
    return table


def _reliability(source: GeometrySource, result: EvaluationResult) -> str:
    diagram = reliability(result.objects.confidence, result.objects.hit, bins=5)
    head = f"{source} geometry: confidence, share of the reported objects, how many are right"
    return "\n".join([head, *diagram.rows(), f"expected calibration error {diagram.error:.3f}\n"])


def _side_by_side(results: dict[GeometrySource, EvaluationResult]) -> Table:
    table = metrics_table("Metrics by geometry (percent, strict mode)", "geometry")
    for source, result in results.items():
        table.add_row(source, *(percent(v) for v in numbers(result.metrics).values()))
    return table


if __name__ == "__main__":
    try:
        tyro.cli(SyntheticBenchmark)()
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
