"""The state of a training on disk: it goes on from there exactly as if it had not stopped."""

import hashlib
import pickle
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from baselines.gaussian_splatting.adam import Adam
from baselines.gaussian_splatting.densify import Pull
from baselines.gaussian_splatting.gaussians import Gaussians
from scenediff_classic.types import View
from scenediff_classic.workspace import replacing


@dataclass
class TrainState:
    """Everything that an iteration reads and changes."""

    iteration: int
    """Iterations done."""
    gaussians: Gaussians
    adam: Adam
    exposures: torch.Tensor
    exposure_adam: tuple[torch.Tensor, torch.Tensor]
    pull: Pull
    queue: list[int]
    """Views still to come before all are shuffled again; the last one comes next."""
    rng: np.random.Generator
    error: float
    """Running mean of the squared error, for the report."""


def fingerprint(views: Sequence[View], start: Gaussians, options: str) -> str:
    """What decides the result of a training, as a short text."""
    digest = hashlib.sha256(options.encode())
    for view in views:
        for array in (view.image, view.intrinsics, view.cam_from_world, view.ignore):
            digest.update(np.ascontiguousarray(array).tobytes())
    for tensor in vars(start).values():
        digest.update(tensor.detach().cpu().numpy().tobytes())
    return digest.hexdigest()


def save_checkpoint(path: Path, key: str, state: TrainState) -> None:
    """Replace the checkpoint; the file is whole or unchanged, whenever the process ends.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    document = {
        "key": key,
        "iteration": state.iteration,
        "gaussians": asdict(state.gaussians.detached()),
        "adam": [asdict(state.adam.mean), asdict(state.adam.square)],
        "exposures": state.exposures,
        "exposure_adam": list(state.exposure_adam),
        "pull": [state.pull.total, state.pull.count],
        "queue": state.queue,
        "rng": state.rng.bit_generator.state,
        "error": state.error,
    }
    with replacing(path) as file:
        torch.save(document, file)


def load_checkpoint(path: Path, key: str, device: str) -> TrainState | None:
    """The state of the training `key`; None if the file is missing, damaged or of another one."""
    try:
        stored: dict[str, Any] = torch.load(path, map_location=device, weights_only=True)
    except (OSError, RuntimeError, EOFError, pickle.UnpicklingError):
        return None
    if not isinstance(stored, dict) or stored.get("key") != key:
        return None
    rng = np.random.default_rng()
    rng.bit_generator.state = stored["rng"]
    return TrainState(
        stored["iteration"],
        Gaussians(**stored["gaussians"]),
        Adam(*(Gaussians(**g) for g in stored["adam"])),
        stored["exposures"],
        (stored["exposure_adam"][0], stored["exposure_adam"][1]),
        Pull(*stored["pull"]),
        stored["queue"],
        rng,
        stored["error"],
    )
