"""Go on training a network on a benchmark's pairs: CYWS-2D* of the paper.

``python -m baselines.cyws.fine_tune --model 2d --benchmark-root BENCHMARK --runs OUT -o RUN``,
where OUT/<pair> is the finished output of `scenediff-classic detect` on each pair.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro
from PIL import Image
from rich.console import Console

from baselines.cyws.annotated_pairs import Labels, read_annotated
from baselines.cyws.curve import draw_curve
from baselines.cyws.networks import Cyws3DDino
from baselines.cyws.pairs import TwoViews, jittered_colour, mirrored
from baselines.cyws.presets import Dimension
from baselines.cyws.training import TrainConfig, Trainer
from baselines.cyws.weights import SHIPPED, fill, preset_of, read_state, write_weights
from scenediff_classic.devices import Device, chosen_device
from scenediff_classic.errors import InputError, SceneDiffError
from scenediff_classic.evaluation.benchmark import Split, find_pairs
from scenediff_classic.terminal import progress_bars
from scenediff_classic.workspace import replacing, write_atomic


@dataclass(frozen=True)
class FineTune:
    """Fine-tune a network on annotated pairs of captures; a stopped call goes on where it was."""

    benchmark_root: Path
    """Folder of annotated pairs: rendered ones, or a benchmark in SceneDiff's layout."""
    runs: Path
    """Folder of finished runs on them, for the geometry: <runs>/<pair>."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for checkpoint, weights and learning curve."""
    model: Dimension = "2d"
    start: Path | None = None
    """Weights to start from; left out: the small ones trained here."""
    split: Split | None = None
    """Only the pairs that the benchmark's split file lists."""
    labels: Labels = "standing"
    """What a picture is to box: changed objects that stand in it, or those of both pictures."""
    held_out: int = 1
    """The last so many pairs of captures are not trained on: the curve is of them. With none,
    it is of the pairs that are trained on."""
    options: TrainConfig = field(
        default_factory=lambda: TrainConfig(pairs=6_000, rate=3e-4, validate_every=1_000)
    )
    until: int | None = None
    """Stop after so many pairs, to go on later."""
    device: Device = "auto"
    """Mixed precision is used on CUDA only."""
    threads: int = 1
    """PyTorch's on the CPU: another number may change the last digits."""

    def __call__(self) -> Trainer:
        """Train, then write ``model.safetensors``, ``curve.json`` and ``curve.png``."""
        torch.set_num_threads(self.threads)
        start = self.start or SHIPPED[self.model]
        state = read_state(start)
        preset = preset_of(state, str(start))
        if not preset.architecture.startswith(f"cyws{self.model}"):
            raise InputError(f"{start} holds weights of {preset.architecture}, no {self.model}.")
        network = preset.build(bias="unet_encoder.0.conv1.bias" in state)
        if isinstance(network, Cyws3DDino):
            raise InputError("The published 3D network cannot be fine-tuned here.")
        fill(network, state, str(start))
        train, judged = self._pairs((preset.height, preset.width))
        given = Drawn(train)
        trainer = Trainer(
            self.model, preset, self.options, self.out, chosen_device(self.device),
            draw=given, origin=f"{_digest(state)} {given.digest}",
        )  # fmt: skip
        if trainer.step == 0:
            trainer.network.load_state_dict(network.state_dict())
        told = Console(stderr=True)
        told.print(f"{len(train)} pairs of frames to train on, {len(judged)} to judge.")
        with progress_bars() as progress:
            try:
                last = None if self.until is None else self.until // self.options.batch
                trainer.run((), judged, progress, last)
            except KeyboardInterrupt:
                trainer.save()
                raise
        trainer.save()
        if trainer.step == self.options.steps:
            self._write(trainer, len(train))
        for point in trainer.curve:
            told.print(f"{point.pairs} pairs: loss {point.loss:.3f}, AP50 {point.ap50:.3f}")
        return trainer

    def _pairs(self, size: tuple[int, int]) -> tuple[list[TwoViews], list[TwoViews]]:
        folders, _ = find_pairs(self.benchmark_root, self.split)
        if not 0 <= self.held_out < len(folders):
            raise InputError(
                f"--held-out {self.held_out} leaves nothing of {len(folders)} pairs to train on."
            )
        found = [
            list(read_annotated(folder, self.runs / folder.name, size, self.labels))
            for folder in folders
        ]
        last = len(found) - self.held_out
        train = [pair for pairs in found[:last] for pair in pairs]
        judged = [pair for pairs in found[last:] for pair in pairs]
        if not train:
            raise InputError("No two frames share half of what they show: nothing to train on.")
        return train, judged or train

    def _write(self, trainer: Trainer, pairs: int) -> None:
        write_weights(trainer.network, self.out / "model.safetensors")
        about = {
            "model": self.model,
            "pairs_of_frames": pairs,
            "labels": self.labels,
            "options": asdict(self.options),
            "curve": [asdict(point) for point in trainer.curve],
        }
        write_atomic(self.out / "curve.json", json.dumps(about, indent=1) + "\n")
        picture = draw_curve(trainer.curve, f"CYWS-{self.model.upper()}, fine-tuned")
        with replacing(self.out / "curve.png") as file:
            Image.fromarray(picture).save(file, "png")


@dataclass(frozen=True)
class Drawn:
    """Draws pairs for a step, mirrored half of the time and with other colours.

    Depth and pose stay as they were found: they have their errors already.
    """

    pairs: Sequence[TwoViews]

    @property
    def digest(self) -> str:
        """Of everything that is drawn from."""
        content = sha256()
        for pair in self.pairs:
            for array in (pair.images, pair.depth, pair.cam_from_world, pair.boxes):
                content.update(array.tobytes())
        return content.hexdigest()

    def __call__(self, rng: np.random.Generator, count: int) -> list[TwoViews]:
        """The pairs that a generator decides."""
        return [self._one(rng) for _ in range(count)]

    def _one(self, rng: np.random.Generator) -> TwoViews:
        pair = self.pairs[int(rng.integers(len(self.pairs)))]
        if rng.uniform() < 0.5:
            pair = mirrored(pair)
        return TwoViews(
            np.stack([jittered_colour(image, rng) for image in pair.images]),
            pair.depth,
            pair.intrinsics,
            pair.cam_from_world,
            pair.boxes,
        )


def _digest(state: dict[str, torch.Tensor]) -> str:
    content = sha256()
    for name in sorted(state):
        content.update(name.encode())
        content.update(state[name].detach().cpu().float().numpy().tobytes())
    return content.hexdigest()


if __name__ == "__main__":
    try:
        tyro.cli(FineTune)()
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
