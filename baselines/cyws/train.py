"""Train a network: ``python -m baselines.cyws.train --model 3d --data SHARDS -o RUN``."""

import json
import sys
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

import torch
import tyro
from PIL import Image
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from baselines.cyws.curve import draw_curve
from baselines.cyws.networks import Cyws3D
from baselines.cyws.pairs import judged_pairs
from baselines.cyws.presets import PRESETS, Dimension
from baselines.cyws.scenes import read_shards
from baselines.cyws.training import TrainConfig, Trainer
from baselines.cyws.weights import load_network, write_weights
from scenediff_classic.devices import Device, chosen_device
from scenediff_classic.errors import InputError, SceneDiffError
from scenediff_classic.workspace import replacing, write_atomic


@dataclass(frozen=True)
class Train:
    """Train a small network on rendered pairs; a stopped training goes on where it was."""

    data: Path
    """Folder of shards (see `baselines.cyws.scenes`) with those of train and val."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for checkpoint, weights and learning curve."""
    model: Dimension = "3d"
    options: TrainConfig = field(default_factory=TrainConfig)
    start: Path | None = None
    """Weights of a 3D network that a 2D network of the same width starts from."""
    until: int | None = None
    """Stop after so many pairs, to go on later."""
    scenes: int | None = None
    """Use only the first so many scenes."""
    validation_pairs: int = 96
    device: Device = "auto"
    """Mixed precision is used on CUDA only."""
    threads: int = 1
    """PyTorch's on the CPU: another number may change the last digits."""

    def __call__(self) -> Trainer:
        """Train, then write ``model.safetensors``, ``curve.json`` and ``curve.png``."""
        torch.set_num_threads(self.threads)
        preset = PRESETS["cyws2d-small" if self.model == "2d" else "cyws3d-small"]
        scenes = read_shards(self.data / "train", self.scenes)
        held_out = judged_pairs(read_shards(self.data / "val"), 4)[: self.validation_pairs]
        trainer = Trainer(
            self.model, preset, self.options, self.out, chosen_device(self.device), self._learnt()
        )
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
        console, told = Console(stderr=True), len(trainer.curve)
        with Progress(*columns, TimeElapsedColumn(), console=console) as bars:
            task = bars.add_task("training")

            def show(stage: str, done: int, total: int) -> None:
                nonlocal told
                bars.update(task, completed=done, total=total)
                if len(trainer.curve) > told:
                    told, point = len(trainer.curve), trainer.curve[-1]
                    console.print(
                        f"{point.pairs} pairs: loss {point.loss:.3f}, AP50 {point.ap50:.3f}"
                    )

            try:
                last = None if self.until is None else self.until // self.options.batch
                trainer.run(scenes, held_out, show, last)
            except KeyboardInterrupt:
                trainer.save()
                raise
        trainer.save()
        if trainer.step == self.options.steps:
            self.write(trainer, len(scenes))
        return trainer

    def _learnt(self) -> Cyws3D | None:
        if self.start is None:
            return None
        network, _ = load_network(self.start)
        if self.model != "2d" or not isinstance(network, Cyws3D):
            raise InputError("--start takes weights of the small 3D network, for --model 2d.")
        return network

    def write(self, trainer: Trainer, scenes: int) -> None:
        """Weights in half precision, and the curve."""
        write_weights(trainer.network, self.out / "model.safetensors")
        about = {
            "model": self.model,
            "scenes": scenes,
            "options": asdict(self.options),
            "curve": [asdict(point) for point in trainer.curve],
        }
        write_atomic(self.out / "curve.json", json.dumps(about, indent=1) + "\n")
        picture = draw_curve(trainer.curve, f"CYWS-{self.model.upper()}, small")
        with replacing(self.out / "curve.png") as file:
            Image.fromarray(picture).save(file, "png")


if __name__ == "__main__":
    try:
        tyro.cli(Train)()
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
