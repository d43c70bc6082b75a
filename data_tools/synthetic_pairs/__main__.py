"""Render synthetic pairs: ``python -m data_tools.synthetic_pairs --split val -o DIR``."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from data_tools.synthetic_pairs.export import write_pair
from data_tools.synthetic_pairs.scene import HardCase, PairSpec
from data_tools.synthetic_pairs.splits import Split, numbered_specs, split_specs
from data_tools.synthetic_pairs.trajectory import Trajectories
from scenediff_classic.errors import InputError, SceneDiffError


@dataclass(frozen=True)
class Options:
    """Render before/after pairs of rooms with known changes, cameras and depth."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for the pairs; those that are there already are kept."""
    split: Split | None = None
    """A named set with fixed seeds; of the options below only --scenes then applies."""
    scenes: int | None = None
    """Number of pairs: 10, or all of the split."""
    seed: int = 0
    """Another seed gives other pairs."""
    frames: int = 10
    """Frames of each capture."""
    width: int = 640
    height: int = 480
    hard_case: tuple[HardCase, ...] = ()
    """Difficulties that every pair shall have."""
    rigid_motion: Literal[0, 1, 2, 3] = 0
    """Instead of other changes, things move by one rigid motion: 1 = table, rug and all on them;
    2 = the sideboard and what is on and before it, too; 3 = also the pictures and the shelf."""
    trajectories: Trajectories = "diverging"
    """Where the after-cameras are: on an arc of their own, or between those of the before-walk. The
    scene, its changes and the before frames are the same."""


def specs_of(options: Options) -> tuple[PairSpec, ...]:
    """The pairs that are asked for.

    Raises
    ------
    InputError
        A number is out of range.
    """
    scenes = 10 if options.scenes is None else options.scenes
    if scenes < 1 or options.frames < 2:
        raise InputError("--scenes must be at least 1 and --frames at least 2.")
    if options.split:
        return split_specs(options.split)[: options.scenes]
    if min(options.width, options.height) < 64 or options.width % 2 or options.height % 2:
        raise InputError("--width and --height must be even and at least 64 (for the video).")
    if options.seed < 0:
        raise InputError("--seed must not be negative.")
    return numbered_specs(
        scenes,
        options.seed,
        options.frames,
        options.width,
        options.height,
        options.hard_case,
        options.rigid_motion,
        options.trajectories,
    )


def main(arguments: list[str] | None = None) -> int:
    """Render what the arguments ask for; returns the exit code."""
    options = tyro.cli(Options, args=arguments, prog="python -m data_tools.synthetic_pairs")
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    try:
        with Progress(*columns, console=console) as progress:
            for spec in specs_of(options):
                task = progress.add_task(spec.name, total=2 * spec.frames)
                write_pair(
                    spec,
                    options.out,
                    lambda done, total, task=task: progress.update(task, completed=done),
                )
                progress.update(task, completed=2 * spec.frames)
    except SceneDiffError as error:
        console.print(str(error), style="red", markup=False, highlight=False, soft_wrap=True)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
