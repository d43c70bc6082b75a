"""The training loop: batches that a seed decides, checkpoints, validation."""

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import process_time

import numpy as np
import torch

from baselines.cyws.attention_targets import attention_loss
from baselines.cyws.average_precision import average_precision, hits
from baselines.cyws.boxes import decode
from baselines.cyws.curve import CurvePoint
from baselines.cyws.cut_paste import cut_paste_pair
from baselines.cyws.networks import Cyws2D, Cyws3D
from baselines.cyws.pairs import TwoViews, augmented, batched, drawn_pair, in_batches
from baselines.cyws.presets import Dimension, Preset
from baselines.cyws.scenes import SceneFrames
from baselines.cyws.targets import encode, loss
from baselines.cyws.transfer import start_from_3d
from scenediff_classic.errors import InputError
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.workspace import replacing


@dataclass(frozen=True)
class TrainConfig:
    """Everything that decides a training beside its scenes."""

    pairs: int = 20_000
    """Shown in all. May be another number when a training goes on: the learning rate then jumps
    to where it stands for that length."""
    batch: int = 16
    rate: float = 1.5e-3
    """Highest learning rate of AdamW: it rises over the first 5 %, then falls as a cosine."""
    decay: float = 1e-3
    clip: float = 5.0
    """Largest norm of the gradient."""
    seed: int = 0
    validate_every: int = 2_000
    """Pairs from one validation to the next."""
    attention: float = 1.0
    """2D alone: weight of the loss that tells co-attention where to look."""
    cut_paste: tuple[float, float] = (0.3, 0.6)
    """2D alone: shares of the training until which all pairs are cut and pasted, with ever larger
    moves, and from which on none are."""

    @property
    def steps(self) -> int:
        """Batches in all."""
        return -(-self.pairs // self.batch)


class Trainer:
    """Trains one network; the same scenes, options and thread count give the same weights.

    Parameters
    ----------
    out : Path
        Folder for the checkpoint; a training stopped there with the same options goes on.
    learnt : Cyws3D, optional
        What a 2D network starts from (see `transfer`).
    draw : callable, optional
        The pairs of a step, drawn by ``draw(rng, count)``, instead of those that scenes give.
    origin : str
        Whatever else decides the training, such as the weights that it starts from.

    Raises
    ------
    InputError
        If the folder holds a training with other options.
    """

    def __init__(
        self,
        model: Dimension,
        preset: Preset,
        config: TrainConfig,
        out: Path,
        device: str = "cpu",
        learnt: Cyws3D | None = None,
        draw: Callable[[np.random.Generator, int], list[TwoViews]] | None = None,
        origin: str = "",
    ) -> None:
        self.model, self.config, self.out, self.device = model, config, out, device
        fixed = {k: v for k, v in asdict(config).items() if k != "pairs"}
        self.identity = json.dumps([model, asdict(preset), fixed, *([origin] if origin else [])])
        self._given = draw
        torch.manual_seed(config.seed)
        self.network = preset.build().to(device)
        if learnt is not None and isinstance(self.network, Cyws2D):
            start_from_3d(self.network, learnt.to(device))
        self.optimiser = torch.optim.AdamW(
            self.network.parameters(), config.rate, weight_decay=config.decay
        )
        self.step, self.seconds = 0, 0.0
        self.curve: list[CurvePoint] = []
        self._recent: list[float] = []
        if self.checkpoint.is_file():
            self._resume()

    @property
    def checkpoint(self) -> Path:
        """Where the unfinished training is kept."""
        return self.out / "checkpoint.pt"

    def run(
        self,
        scenes: Sequence[SceneFrames],
        held_out: Sequence[TwoViews],
        progress: Progress = silent,
        until: int | None = None,
    ) -> None:
        """Train to the end, or to step `until`."""
        every = max(self.config.validate_every // self.config.batch, 1)
        last = min(until or self.config.steps, self.config.steps)
        while self.step < last:
            start = process_time()
            self._recent.append(self._learn(scenes))
            self.step += 1
            self.seconds += process_time() - start
            if self.step % every == 0 or self.step == self.config.steps:
                mean = float(np.mean(self._recent))
                score = box_ap(self.network, held_out, device=self.device)
                shown = self.step * self.config.batch
                self.curve.append(CurvePoint(shown, mean, score, self.seconds))
                self._recent = []
                self.save()
            progress("training", self.step, self.config.steps)

    def save(self) -> None:
        """Write the checkpoint."""
        state = {
            "identity": self.identity,
            "network": self.network.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
            "curve": [asdict(point) for point in self.curve],
            "recent": self._recent,
        }
        with replacing(self.checkpoint) as file:
            torch.save(state, file)

    def _resume(self) -> None:
        state = torch.load(self.checkpoint, map_location=self.device, weights_only=True)
        if state["identity"] != self.identity:
            raise InputError(f"{self.out} holds a training with other options: choose another.")
        self.network.load_state_dict(state["network"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step, self.seconds = state["step"], state["seconds"]
        self.curve = [CurvePoint(**point) for point in state["curve"]]
        self._recent = list(state["recent"])

    def _learn(self, scenes: Sequence[SceneFrames]) -> float:
        batch = batched(self._draw(scenes))
        images, geometry = batch.images.to(self.device), batch.registration.to(self.device)
        for group in self.optimiser.param_groups:
            group["lr"] = self.config.rate * _schedule(self.step / self.config.steps)
        self.network.train()
        mixed = self.device != "cpu"
        with torch.autocast(self.device, enabled=mixed, dtype=torch.bfloat16):
            if isinstance(self.network, Cyws2D):
                maps, logits = self.network.with_attention(images)
                extra = self.config.attention * attention_loss(logits, geometry)
            else:
                maps, extra = self.network(images, geometry), 0.0
        stride = images.shape[-1] / maps.heat.shape[-1]
        rows, columns = maps.heat.shape[-2:]
        targets = encode(batch.boxes(), rows, columns, stride).to(self.device)
        total = loss(maps, targets) + extra
        self.optimiser.zero_grad()
        total.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.config.clip)
        self.optimiser.step()
        return float(total.detach())

    def _draw(self, scenes: Sequence[SceneFrames]) -> list[TwoViews]:
        rng = np.random.default_rng([self.config.seed, self.step])
        if self._given is not None:
            return self._given(rng, self.config.batch)
        begin, end = self.config.cut_paste
        done = self.step / self.config.steps
        share = float(np.clip((end - done) / max(end - begin, 1e-9), 0, 1))
        pairs = []
        for _ in range(self.config.batch):
            if self.model == "2d" and rng.uniform() < share:
                strength = min(done / max(begin, 1e-9), 1.0)
                pairs.append(cut_paste_pair(scenes, rng, strength))
            else:
                pairs.append(augmented(drawn_pair(scenes, rng), rng))
        return pairs


def box_ap(
    network: torch.nn.Module, pairs: Sequence[TwoViews], batch: int = 16, device: str = "cpu"
) -> float:
    """AP50 of the raw boxes in both pictures of pairs with true geometry."""
    network.eval()
    score, right, total = [], [], 0
    for some in in_batches(pairs, batch):
        with torch.inference_mode():
            maps = network(some.images.to(device), some.registration.to(device))
        for found, truth in zip(decode(maps, *some.images.shape[-2:]), some.boxes(), strict=True):
            score.append(found.score)
            right.append(hits(found, truth))
            total += len(truth)
    return average_precision(score, right, total)


def _schedule(done: float, warm: float = 0.05) -> float:
    if done < warm:
        return (done + 1e-3) / (warm + 1e-3)
    return 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * (done - warm) / (1 - warm)))
