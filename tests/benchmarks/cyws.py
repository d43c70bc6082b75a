"""What the CYWS networks cost: pairs a second, processor time and memory, training and inference.

``python -m tests.benchmarks.cyws`` measures the small networks at both and those of published width
(random weights) at inference, each in a process of its own on one thread, and prints a table.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import pytest
import torch
import tyro

from baselines.cyws.boxes import decode
from baselines.cyws.pairs import in_batches, judged_pairs
from baselines.cyws.presets import PRESETS, Architecture, Dimension, Preset
from baselines.cyws.rendered_folders import resized
from baselines.cyws.scenes import SceneFrames, render_scene
from baselines.cyws.training import TrainConfig, Trainer
from data_tools.synthetic_pairs.scene import PairSpec

Work = Literal["training", "inference"]
WARM = 1
"""Batches that are not counted: the first one allocates memory and chooses algorithms."""


@dataclass(frozen=True)
class Figures:
    """One row of the table."""

    name: str
    work: Work
    height: int
    width: int
    """Of the network's input, in pixels."""
    parameters: int
    batch: int
    pairs: int
    """That were counted."""
    cpu_s: float
    """Processor time for a pair."""
    wall_s: float
    peak_gib: float
    """Of the whole process, PyTorch and all."""


def measure(name: str, preset: Preset, work: Work, batch: int, batches: int) -> Figures:
    """Run a network for some batches after `WARM` others.

    Training is a step as `baselines.cyws.train` takes it: pairs are drawn and augmented, and the 2D
    network learns from its attention, too. Inference begins with pairs in memory and ends with
    boxes.
    """
    torch.set_num_threads(1)
    scene = resized(_rendered(), preset.height, preset.width)
    with tempfile.TemporaryDirectory() as folder:
        if work == "training":
            parameters, steps = _training(preset, scene, batch, WARM + batches, Path(folder))
        else:
            parameters, steps = _inference(preset, scene, batch, WARM + batches)
        for _ in range(WARM):
            next(steps)
        cpu, wall = time.process_time(), time.perf_counter()
        done = sum(1 for _ in steps)
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    count = done * batch
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return Figures(
        name, work, preset.height, preset.width, parameters, batch, count, cpu / count,
        wall / count, peak,
    )  # fmt: skip


def _rendered() -> SceneFrames:
    return render_scene(PairSpec("x", 9, frames=4, width=160, height=128, texture_size=256))


def _training(
    preset: Preset, scene: SceneFrames, batch: int, steps: int, out: Path
) -> tuple[int, Iterator[None]]:
    model: Dimension = "2d" if "2d" in preset.architecture else "3d"
    # without cut-paste pairs, as the shipped ones learnt; a last step, which validates, never comes
    pairs = (steps + 1) * batch
    config = TrainConfig(pairs, batch, validate_every=2 * pairs, cut_paste=(0.0, 0.0))
    trainer = Trainer(model, preset, config, out)

    def run() -> Iterator[None]:
        for step in range(1, steps + 1):
            trainer.run([scene], [], until=step)
            yield

    return _parameters(trainer.network), run()


def _inference(
    preset: Preset, scene: SceneFrames, batch: int, steps: int
) -> tuple[int, Iterator[None]]:
    network = preset.build().eval()
    some = judged_pairs([scene], 16)
    pairs = [some[k % len(some)] for k in range(steps * batch)]

    def run() -> Iterator[None]:
        for part in in_batches(pairs, batch):
            with torch.inference_mode():
                decode(network(part.images, part.registration), preset.height, preset.width)
            yield

    return _parameters(network), run()


def _parameters(network: torch.nn.Module) -> int:
    return sum(p.numel() for p in network.parameters())


def table(rows: Sequence[Figures]) -> str:
    """One line a row."""
    head = (
        "network            input    million   work       batch  pairs  pairs/s  CPU s a pair"
        "  wall s  peak GiB"
    )
    lines = [
        f"{r.name:18} {f'{r.height}x{r.width}':8} {r.parameters / 1e6:7.1f}   {r.work:10}"
        f"{r.batch:6}{r.pairs:7}{1 / r.wall_s:9.2f}{r.cpu_s:14.3f}{r.wall_s:8.3f}{r.peak_gib:10.2f}"
        for r in rows
    ]
    return "\n".join([head, *lines])


@dataclass(frozen=True)
class Options:
    """Throughput of the networks."""

    batch: int = 16
    """Pairs in a batch of a small network."""
    batches: int = 6
    """That are counted, of a small network."""
    published_batches: int = 2
    """That are counted, of a network of published width; each is one pair."""
    networks: tuple[Architecture, ...] = get_args(Architecture)
    only: tuple[Architecture, Work] | None = None
    """Measure this in this process and print its figures as JSON."""


def main(options: Options) -> None:
    """Print the table."""
    if options.only is not None:
        name, work = options.only
        print(json.dumps(asdict(_measured(name, work, options))))
        return
    rows = []
    for name in options.networks:
        for work in get_args(Work) if name.endswith("small") else ("inference",):
            rows.append(_in_own_process(name, work, options))
            print(f"{name}, {work}: measured", file=sys.stderr, flush=True)
    print("One thread; pairs/s by the clock; peak memory of the whole process")
    print(table(rows))


def _measured(name: Architecture, work: Work, options: Options) -> Figures:
    if name.endswith("small"):
        return measure(name, PRESETS[name], work, options.batch, options.batches)
    return measure(name, PRESETS[name], work, 1, options.published_batches)


def _in_own_process(name: str, work: str, options: Options) -> Figures:
    command = [
        sys.executable, "-m", __spec__.name, "--only", name, work, "--batch", str(options.batch),
        "--batches", str(options.batches), "--published-batches", str(options.published_batches),
    ]  # fmt: skip
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return Figures(**json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize("model", ["2d", "3d"])
@pytest.mark.parametrize("work", get_args(Work))
def test_a_tiny_network_is_measured(model: Dimension, work: Work) -> None:
    small = PRESETS["cyws2d-small" if model == "2d" else "cyws3d-small"]
    tiny = replace(small, channels=4, height=64, width=96)
    threads = torch.get_num_threads()
    try:
        figures = measure("tiny", tiny, work, batch=2, batches=3)
    finally:
        torch.set_num_threads(threads)
    assert figures.pairs == 6  # the first batch is not counted
    assert 0 < figures.cpu_s < 5
    assert figures.wall_s > 0
    assert figures.peak_gib > 0.05
    assert figures.parameters == sum(p.numel() for p in tiny.build().parameters())


def test_every_row_has_its_line() -> None:
    row = Figures("cyws3d-small", "training", 128, 160, 1_000_000, 16, 96, 0.2, 0.25, 1.5)
    head, line = table([row]).splitlines()
    assert len(head) == len(line)
    assert line.split() == [
        "cyws3d-small", "128x160", "1.0", "training", "16", "96", "4.00", "0.200", "0.250", "1.50"
    ]  # fmt: skip


if __name__ == "__main__":
    main(tyro.cli(Options))
