"""Gaussians from posed pictures.

``train(views, points, config) -> Trained(gaussians, exposures, iterations)``. To go on with a model
on other pictures, give it as `start`: ``train(views, None, config, start=gaussians)``.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from jaxtyping import Float

from baselines.gaussian_splatting.adam import Adam, update
from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.checkpoint import (
    TrainState,
    fingerprint,
    load_checkpoint,
    save_checkpoint,
)
from baselines.gaussian_splatting.densify import DensifyConfig, Pull, densify, reset_opacities
from baselines.gaussian_splatting.exposure import Exposures, applied
from baselines.gaussian_splatting.gaussians import Gaussians, Points
from baselines.gaussian_splatting.losses import Target, photometric_loss, psnr
from baselines.gaussian_splatting.rasterizer import render
from baselines.gaussian_splatting.threads import one_torch_thread
from scenediff_classic.devices import Device, chosen_device
from scenediff_classic.errors import InputError
from scenediff_classic.types import View


@dataclass(frozen=True)
class Rates:
    """Learning rates."""

    means: float = 1.6e-4
    """At the start, as a share of the scene's extent."""
    means_end: float = 1.6e-6
    scales: float = 5e-3
    rotations: float = 1e-3
    opacities: float = 0.05
    colours: float = 2.5e-3
    harmonics: float = 1.25e-4
    """Of the coefficients above degree 0."""
    exposure: float = 1e-3


@dataclass(frozen=True)
class TrainConfig:
    """How Gaussians are trained."""

    iterations: int = 1000
    degree: int = 2
    """Of the spherical harmonics, 0 to 3."""
    degree_every: int = 400
    """Iterations after which the next degree joins in."""
    coarse: tuple[tuple[float, int], ...] = ((0.15, 4), (0.4, 2))
    """Until this share of the training, pictures are this many times smaller."""
    rates: Rates = field(default_factory=Rates)
    densify: DensifyConfig | None = field(default_factory=DensifyConfig)
    """None: the number of Gaussians stays."""
    exposure: bool = True
    """Fit an affine colour map for each picture."""
    seed: int = 0
    device: Device = "cpu"
    checkpoint_every: int = 250


class TrainProgress(NamedTuple):
    """What is reported after an iteration."""

    iteration: int
    iterations: int
    gaussians: int
    loss: float
    psnr: float
    """Mean over the latest iterations, in dB."""
    remaining_s: float

    def __str__(self) -> str:
        """One line."""
        return (
            f"{self.iteration}/{self.iterations}  {self.gaussians} Gaussians  "
            f"loss {self.loss:.4f}  PSNR {self.psnr:.2f} dB  {self.remaining_s:.0f} s left"
        )


@dataclass(frozen=True)
class Trained:
    """A finished training."""

    gaussians: Gaussians
    exposures: Exposures
    """In the order of the views."""
    iterations: int


def train(
    views: Sequence[View],
    points: Points | None,
    config: TrainConfig = TrainConfig(),
    *,
    start: Gaussians | None = None,
    checkpoint: Path | None = None,
    progress: Callable[[TrainProgress], None] | None = None,
) -> Trained:
    """Fit Gaussians to pictures with known cameras.

    The same arguments give the same result on the same machine; so does a training that was
    interrupted and continued from its checkpoint.

    Parameters
    ----------
    views : sequence of View
        Pixels to `ignore` count for nothing; depth is not used.
    points : Points, optional
        Where Gaussians start (see `Points.of`).
    start : Gaussians, optional
        What to start from instead.
    checkpoint : Path, optional
        File for the state of the training. If it holds that of the same training (same pictures,
        cameras, start and options), it is continued.
    progress : callable, optional
        Called after every iteration.

    Raises
    ------
    InputError
        If there are no views or nothing to start from, or CUDA is asked for and not there.
    OutputError
        If the checkpoint cannot be written.
    """
    if not views:
        raise InputError("Gaussians cannot be trained without any picture that has a camera.")
    if start is None:
        if points is None:
            raise InputError("Gaussians need points, or a model, to start from.")
        start = Gaussians.start(points, config.degree)
    device = chosen_device(config.device)
    training = _Training(views, start.detached(), config, device)
    key = fingerprint(views, start, repr(config)) if checkpoint else ""
    state = load_checkpoint(checkpoint, key, device) if checkpoint else None
    state = state or training.first_state()
    began, first = time.monotonic(), state.iteration
    while state.iteration < config.iterations:
        with one_torch_thread():
            loss, error = training.iterate(state)
        state.error = error if state.iteration == 1 else 0.95 * state.error + 0.05 * error
        if progress:
            pace = (time.monotonic() - began) / (state.iteration - first)
            left = pace * (config.iterations - state.iteration)
            numbers = (len(state.gaussians), loss, psnr(state.error), left)
            progress(TrainProgress(state.iteration, config.iterations, *numbers))
        if checkpoint and (
            state.iteration % config.checkpoint_every == 0 or state.iteration == config.iterations
        ):
            save_checkpoint(checkpoint, key, state)
    return Trained(
        state.gaussians.map(lambda t: t.detach().cpu()),
        Exposures(state.exposures.detach().cpu()),
        state.iteration,
    )


class _Training:
    """What does not change during a training, and how one iteration changes the rest."""

    def __init__(
        self, views: Sequence[View], start: Gaussians, config: TrainConfig, device: str
    ) -> None:
        self.config, self.device, self.start = config, device, start
        self.pictures = [_pyramid(view, config, device) for view in views]
        self.extent = scene_extent(views, start)

    def first_state(self) -> TrainState:
        gaussians = self.start.map(lambda t: t.clone().to(self.device))
        exposures = Exposures.start(len(self.pictures)).maps.to(self.device)
        return TrainState(
            0, gaussians, Adam.start(gaussians), exposures,
            (torch.zeros_like(exposures), torch.zeros_like(exposures)), Pull.start(gaussians),
            [], np.random.default_rng(self.config.seed), 0.0,
        )  # fmt: skip

    def iterate(self, state: TrainState) -> tuple[float, float]:
        """One picture: the loss, and the mean squared error."""
        config = self.config
        if not state.queue:
            state.queue = state.rng.permutation(len(self.pictures)).tolist()
        index = state.queue.pop()
        share = state.iteration / config.iterations
        smaller = next((factor for until, factor in config.coarse if share < until), 1)
        camera, target = self.pictures[index][smaller]
        state.iteration += 1

        leaf = state.gaussians.map(lambda t: t.detach().requires_grad_())
        shift = leaf.means.new_zeros((len(leaf), 2), requires_grad=True)
        maps = state.exposures[index].detach().requires_grad_(config.exposure)
        degree = (state.iteration - 1) // config.degree_every
        rendering = render(leaf, camera, degree=degree, screen_shift=shift)
        planes = rendering.rgb.permute(2, 0, 1)
        shown = applied(planes, maps) if config.exposure else planes
        loss = photometric_loss(shown, target)
        loss.backward()
        with torch.no_grad():
            error = (shown - target.planes) ** 2
            if target.ignore is not None:
                error = error[:, ~target.ignore]
            self._step(state, leaf, rendering.visible, maps, index)
            if shift.grad is not None:
                state.pull.add(shift.grad, rendering.visible, (camera.height, camera.width))
            self._renumber(state)
        return float(loss.detach()), float(error.mean()) if error.numel() else 0.0

    def _step(
        self,
        state: TrainState,
        leaf: Gaussians,
        visible: torch.Tensor,
        maps: torch.Tensor,
        index: int,
    ) -> None:
        config, rates = self.config, self.config.rates
        done = state.iteration / config.iterations
        means = rates.means ** (1 - done) * rates.means_end**done * self.extent
        terms = leaf.sh.shape[1]
        sh = np.full((terms, 3), rates.harmonics)
        sh[0] = rates.colours
        by_name = {
            "means": np.full(3, means), "log_scales": np.full(3, rates.scales),
            "quaternions": np.full(4, rates.rotations),
            "opacity_logits": np.full(1, rates.opacities), "sh": sh.ravel(),
        }  # fmt: skip
        state.adam.step(leaf, by_name, visible, state.iteration)
        state.gaussians = leaf.detached()
        if maps.grad is not None:
            seen = torch.ones(1, dtype=torch.bool, device=maps.device)
            mean, square = (m[index].reshape(1, 12) for m in state.exposure_adam)
            parameter, grad = maps.detach().reshape(1, 12), maps.grad.reshape(1, 12)
            steps = 1 + (state.iteration - 1) // len(self.pictures)
            update(parameter, grad, mean, square, np.full(12, rates.exposure), seen, steps)
            # all maps together could hide any change of the scene's colours: the mean map is none
            state.exposures[index] = maps.detach()
            state.exposures += torch.eye(3, 4, device=maps.device) - state.exposures.mean(dim=0)

    def _renumber(self, state: TrainState) -> None:
        """Densify, prune and reset when it is time."""
        config, number = self.config.densify, state.iteration
        if config is None or number > config.until * self.config.iterations:
            return
        if number >= config.start and number % config.every == 0:
            state.gaussians, state.adam = densify(
                state.gaussians, state.adam, state.pull.mean(), self.extent, config, state.rng
            )
            state.pull = Pull.start(state.gaussians)
        if number % config.reset_every == 0:
            reset_opacities(state.gaussians, state.adam, config)


def scene_extent(views: Sequence[View], gaussians: Gaussians) -> float:
    """A length to measure the scene by: the median distance of its points from the cameras."""
    centres = np.stack([-v.cam_from_world[:3, :3].T @ v.cam_from_world[:3, 3] for v in views])
    away = gaussians.means.cpu().numpy() - centres.mean(axis=0)
    return float(np.median(np.linalg.norm(away, axis=1)))


def _pyramid(
    view: View, config: TrainConfig, device: str
) -> dict[int, tuple[PinholeCamera, Target]]:
    """Camera and picture at every resolution that the training uses."""
    camera = PinholeCamera.of(view)
    out = {}
    for factor in {1, *(factor for _, factor in config.coarse)}:
        height, width = (max(round(n / factor), 1) for n in view.shape)
        image = _shrunk(view.image.astype(np.float32) / np.float32(255), height, width)
        ignore = _shrunk(view.ignore.astype(np.float32), height, width) > 0
        planes = torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1))).to(device)
        out[factor] = camera.resized(height, width), Target.of(planes, ignore)
    return out


def _shrunk(
    picture: Float[np.ndarray, "h w *c"], height: int, width: int
) -> Float[np.ndarray, "h2 w2 *c"]:
    if picture.shape[:2] == (height, width):
        return picture
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
