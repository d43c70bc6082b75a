"""Whether a method needs after-cameras near the before-cameras.

``python -m tests.benchmarks.trajectories -o OUT`` renders the same rooms twice: with after-cameras
on an arc of their own (diverging), and between the before-cameras (interpolating). It runs our
method, 3DGS-CD and MV3DCD on both and prints one table. Finished pairs and answers are kept, so a
killed run continues.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import pytest
import tyro
from rich.console import Console

from baselines.mv3dcd.detector import Mv3dcdConfig, detect_with_mv3dcd
from baselines.splat_change.models import ModelConfig
from baselines.threedgs_cd.detector import ThreedgsCdConfig, detect_with_3dgs_cd
from data_tools.benchmarks.row_tables import metrics_table, numbers, percent
from data_tools.synthetic_pairs.export import write_pair
from data_tools.synthetic_pairs.splits import numbered_specs
from data_tools.synthetic_pairs.trajectory import Trajectories
from scenediff_classic.detection_run import CaptureOptions, Detect, run_detection
from scenediff_classic.errors import SceneDiffError
from scenediff_classic.evaluation.benchmark import evaluate
from scenediff_classic.pipeline import detect_changes
from scenediff_classic.presets import configured
from scenediff_classic.workspace import write_atomic

Source = Literal["true", "estimated"]
Method = Literal["ours", "3DGS-CD", "MV3DCD"]


@dataclass(frozen=True)
class Options:
    """Three methods on diverging and on interpolating trajectories."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for pairs, answers and the table."""
    geometry: Source = "true"
    """estimated: cameras and depth as our method finds them, for all three."""
    methods: tuple[Method, ...] = get_args(Method)
    scenes: int = 2
    frames: int = 8
    """Of each capture."""
    width: int = 640
    height: int = 480
    seed: int = 0


def main(options: Options) -> dict[str, dict[str, float | None]]:
    """Render, detect, score; print the table and write it to ``OUT/trajectories.json``."""
    console = Console()
    title = f"{options.scenes} scenes, {options.frames} + {options.frames} frames"
    table = metrics_table(f"{title}, {options.geometry} geometry (percent, strict)", "")
    figures = {}
    for kind in get_args(Trajectories):
        pairs = options.out / "pairs" / kind
        specs = numbered_specs(
            options.scenes, options.seed, options.frames, options.width, options.height, (), 0, kind
        )
        for spec in specs:
            write_pair(spec, pairs)
        for method in options.methods:
            answers = options.out / options.geometry / kind / method
            for spec in specs:
                console.print(f"{kind}, {method}: {spec.name}")
                try:
                    _answer(method, pairs / spec.name, answers / spec.name, options)
                except SceneDiffError as error:  # counts as all missed
                    console.print(f"  failed: {error}")
            answers.mkdir(parents=True, exist_ok=True)
            found = numbers(evaluate(answers, pairs).metrics)
            figures[f"{kind}, {method}"] = found
            table.add_row(f"{kind}, {method}", *(percent(v) for v in found.values()))
    console.print(table)
    write_atomic(options.out / "trajectories.json", json.dumps(figures, indent=1) + "\n")
    return figures


def _answer(method: Method, pair: Path, out: Path, options: Options) -> None:
    known = pair / "truth_geometry.npz"
    if options.geometry == "estimated":
        known = out.parents[1] / "ours" / pair.name
        if method != "ours" and not known.is_dir():
            _answer("ours", pair, known, options)
    uses = () if (options.geometry, method) == ("estimated", "ours") else (known,)
    detect, config = _detector(method, uses[0] if uses else None)
    run_detection(
        CaptureOptions(pair / "before"), CaptureOptions(pair / "after"), out, detect, config,
        uses=uses, command=tuple(sys.argv),
    )  # fmt: skip


def _detector(method: Method, known: Path | None) -> tuple[Detect, Any]:
    ours = configured(geometry=known)
    if method == "ours":
        return _bound(detect_changes, ours), ours
    if method == "3DGS-CD":
        splat = ThreedgsCdConfig(geometry=ours.geometry, models=ModelConfig())
        return _bound(detect_with_3dgs_cd, splat), splat
    channel = Mv3dcdConfig(geometry=ours.geometry, models=ModelConfig())
    return _bound(detect_with_mv3dcd, channel), channel


def _bound(detect: Callable[..., Any], config: Any) -> Detect:
    return lambda before, after, workspace, progress: detect(
        before, after, config, workspace=workspace, progress=progress
    )


@pytest.mark.slow
def test_both_trajectories_in_one_table(tmp_path: Path) -> None:
    few = Options(tmp_path, methods=("3DGS-CD",), scenes=1, frames=3, width=128, height=96)
    figures = main(few)
    assert list(figures) == ["diverging, 3DGS-CD", "interpolating, 3DGS-CD"]
    assert json.loads((tmp_path / "trajectories.json").read_text()) == figures
    pictures = [
        (tmp_path / "pairs" / kind / "pair_0000" / "before" / "0001.png").read_bytes()
        for kind in get_args(Trajectories)
    ]
    assert pictures[0] == pictures[1]


if __name__ == "__main__":
    try:
        main(tyro.cli(Options))
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
