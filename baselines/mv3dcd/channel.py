"""Change masks of single views, fused by a scalar that every Gaussian carries."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Float32

from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.channels import ChannelConfig, fit_channel
from baselines.gaussian_splatting.gaussians import Gaussians
from baselines.gaussian_splatting.losses import Target, photometric_loss
from baselines.gaussian_splatting.rasterizer import accumulate, render
from baselines.gaussian_splatting.train import train
from baselines.mv3dcd.cues import CueConfig, change_mask
from baselines.splat_change.models import ModelConfig, Render, completed, renders
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.types import Geometry, View

Mode = Literal["optimised", "closed-form"]
LossName = Literal["photometric", "self-adjusting"]


@dataclass(frozen=True)
class FusionConfig:
    """How the channel is found."""

    mode: Mode = "optimised"
    """closed-form: the mean of what the masks say of each Gaussian; one pass a view."""
    loss: LossName = "photometric"
    """photometric: 0.8 L1 + 0.2 (1 - SSIM). self-adjusting: change where the masks have none is
    punished, and change everywhere."""
    update: int = 150
    """Iterations in which the reference model learns the other capture's pictures."""
    iterations: int = 120
    """Of the channel, on masks of captured pictures."""
    augmented: int = 120
    """Further ones, on masks of renders of the updated model at all cameras; 0 = none."""
    seed: int = 0


@dataclass(frozen=True)
class Fused:
    """The change channel from the cameras of some views, and what it was made of."""

    change: dict[int, Float32[np.ndarray, "h w"]]
    """0 to 1, by position of the view; NaN where the reference model knows nothing."""
    masks: dict[int, Float32[np.ndarray, "h w"]]
    """Of captured against rendered pictures."""
    reference: dict[int, Render]


def fused(
    reference: Gaussians,
    geometry: Geometry,
    known: Sequence[int],
    now: Sequence[int],
    cues: CueConfig,
    config: FusionConfig,
    models: ModelConfig,
    workspace: Path,
    progress: Progress = silent,
) -> Fused:
    """What changed since the reference, as a map for each new picture.

    Parameters
    ----------
    reference : Gaussians
        Model of one capture.
    known : sequence of int
        Positions of the views it was made of.
    now : sequence of int
        Positions of the other capture's views.
    models : ModelConfig
        How the reference model was learned; its update learns alike.
    """
    views = [geometry.views[k] for k in now]
    video = views[0].video
    shown = renders(reference, views)
    masks = [change_mask(v, r.image, r.known, cues) for v, r in zip(views, shown, strict=True)]
    progress(f"{video} masks", 1, 1)
    updated = train(
        views,
        None,
        replace(models.train, iterations=config.update, coarse=(), degree_every=1, densify=None),
        start=completed(reference, geometry, now, models),
        checkpoint=workspace / f"updated_on_{video}.gaussians",
        progress=lambda p: progress(f"{video} update", p.iteration, p.iterations),
    ).gaussians
    everywhere = [*now, *known]
    cameras = [PinholeCamera.of(geometry.views[k]) for k in everywhere]
    more = augmentation(
        reference, updated, [geometry.views[k] for k in everywhere], cues
    ) if config.augmented else []  # fmt: skip
    if config.mode == "closed-form":
        draw = _closed_form(updated, cameras, masks, more)
    else:
        draw = _optimised(updated, cameras, masks, more, config, f"{video} channel", progress)
    change = {}
    for k, view, seen in zip(now, views, shown, strict=True):
        drawn = draw(PinholeCamera.of(view))
        change[k] = np.where(seen.known & ~view.ignore, drawn, np.nan).astype(np.float32)
    return Fused(change, dict(zip(now, masks, strict=True)), dict(zip(now, shown, strict=True)))


def augmentation(
    reference: Gaussians, updated: Gaussians, views: Sequence[View], cues: CueConfig
) -> list[Float32[np.ndarray, "h w"]]:
    """Masks of the updated model's renders against the reference model's, at each view's camera."""
    out = []
    for view in views:
        (then,), (today,) = renders(reference, [view]), renders(updated, [view])
        out.append(change_mask(today.as_view(view), then.image, then.known, cues))
    return out


def self_adjusting(drawn: Float[torch.Tensor, "1 h w"], target: Target) -> Float[torch.Tensor, ""]:
    """mean(C (1 - M)) + log(1 + mean(M)²): drawn change M must explain the masks C, and be rare."""
    if target.ignore is not None:
        drawn = drawn.masked_fill(target.ignore, 0)
    unexplained = (target.planes * (1 - drawn)).mean()
    return unexplained + torch.log1p(drawn.mean() ** 2)


def _optimised(
    updated: Gaussians,
    cameras: Sequence[PinholeCamera],
    masks: Sequence[np.ndarray],
    more: Sequence[np.ndarray],
    config: FusionConfig,
    stage: str,
    progress: Progress,
) -> Callable[[PinholeCamera], Float32[np.ndarray, "h w"]]:
    total = config.iterations + (config.augmented if more else 0)
    loss = self_adjusting if config.loss == "self-adjusting" else photometric_loss
    first = ChannelConfig(config.iterations, loss=loss, seed=config.seed)
    channel = fit_channel(
        updated, cameras[: len(masks)], masks, first,
        progress=lambda done, _: progress(stage, done, total),
    )  # fmt: skip
    if more:
        # captured pictures stay part of it: what renders cannot show would be forgotten
        channel = fit_channel(
            updated, [*cameras[: len(masks)], *cameras], [*masks, *more],
            replace(first, iterations=config.augmented), start=channel,
            progress=lambda done, _: progress(stage, config.iterations + done, total),
        )  # fmt: skip
    return channel.render


def _closed_form(
    updated: Gaussians,
    cameras: Sequence[PinholeCamera],
    masks: Sequence[np.ndarray],
    more: Sequence[np.ndarray],
) -> Callable[[PinholeCamera], Float32[np.ndarray, "h w"]]:
    pictures = [m[..., None] for m in (*masks, *more)]
    views = [*cameras[: len(masks)], *(cameras if more else ())]
    means, _ = accumulate(updated, views, pictures)
    values = torch.nan_to_num(means)

    def draw(camera: PinholeCamera) -> Float32[np.ndarray, "h w"]:
        with torch.no_grad():
            drawn = render(updated, camera, extra=values.to(updated.means.device), degree=0)
        share = drawn.extra[..., 0] / drawn.alpha.clamp(min=1e-6)
        return share.cpu().numpy().astype(np.float32)

    return draw
