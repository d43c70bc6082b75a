"""Gaussians of each capture, and pictures of them from the other capture's cameras."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float32, UInt8
from scipy.spatial import KDTree

from baselines.gaussian_splatting.camera import PinholeCamera
from baselines.gaussian_splatting.gaussians import Gaussians, Points
from baselines.gaussian_splatting.rasterizer import KNOWN_ALPHA, render
from baselines.gaussian_splatting.train import TrainConfig, train
from scenediff_classic.cameras import scale_intrinsics
from scenediff_classic.change.harmonise import HarmoniseConfig, harmonised
from scenediff_classic.change.scale import normalised
from scenediff_classic.change.visibility import VisibilityConfig, pair_views
from scenediff_classic.errors import AlignmentError
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.types import VIDEOS, Geometry, Video, View

DIRECTIONS: tuple[tuple[Video, Video], ...] = (("after", "before"), ("before", "after"))
"""(whose pictures are searched, whose model they are compared with)."""

NEW = 2.5
"""A point is new if the model has nothing within this many times the points' usual distance."""


@dataclass(frozen=True)
class ModelConfig:
    """How the captures are modelled."""

    long_side: int = 320
    """Longer side of the pictures that are learned and rendered, in pixels."""
    points: int = 20_000
    """Gaussians at the start, at most; their number stays where depth gives them."""
    every: int = 1
    """Only every n-th frame is searched for changes; all are learned. The paper: frames at 3 a
    second, every third of them."""
    train: TrainConfig = field(
        default_factory=lambda: TrainConfig(
            iterations=400, degree=1, degree_every=200, densify=None, checkpoint_every=100
        )
    )


@dataclass(frozen=True)
class Render:
    """What a model shows from the camera of a view of the other capture."""

    image: UInt8[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"]
    """z-depth; NaN where the model has nothing."""
    alpha: Float32[np.ndarray, "h w"]
    """How much the model has in a pixel: below one half, it never saw the place."""

    @property
    def known(self) -> Bool[np.ndarray, "h w"]:
        """Where the model can tell what was there."""
        return self.alpha > KNOWN_ALPHA

    def as_view(self, view: View) -> View:
        """The view as it would be if it showed the model; what the model lacks is ignored."""
        return replace(
            view,
            image=self.image,
            depth=self.depth,
            measured=np.isfinite(self.depth),
            confidence=np.isfinite(self.depth).astype(np.float32),
            ignore=view.ignore | ~self.known,
        )


def prepared(estimated: Geometry, long_side: int) -> Geometry:
    """The geometry at unit extent, with equalised colours, and views of a smaller size.

    Raises
    ------
    AlignmentError
        If a capture has no view.
    """
    if not all(estimated.of(video) for video in VIDEOS):
        raise AlignmentError("No picture of one capture could be placed in the other's scene.")
    geometry = normalised(estimated)
    views = tuple(shrunk(view, long_side) for view in geometry.views)
    geometry = replace(geometry, views=views)
    seen = VisibilityConfig()
    return harmonised(geometry, pair_views(geometry, seen), HarmoniseConfig(), seen).geometry


def shrunk(view: View, long_side: int) -> View:
    """The view with a picture of another size; never a larger one."""
    height, width = view.shape
    factor = long_side / max(height, width)
    if factor >= 1:
        return view
    size = max(round(width * factor), 1), max(round(height * factor), 1)

    def nearest(plane: np.ndarray) -> np.ndarray:
        return cv2.resize(plane, size, interpolation=cv2.INTER_NEAREST)

    return replace(
        view,
        image=cv2.resize(view.image, size, interpolation=cv2.INTER_AREA),
        intrinsics=scale_intrinsics(view.intrinsics, size[0] / width, size[1] / height),
        depth=nearest(view.depth),
        confidence=nearest(view.confidence),
        measured=nearest(view.measured.astype(np.uint8)) > 0,
        ignore=nearest(view.ignore.astype(np.uint8)) > 0,
    )


def compared(geometry: Geometry, video: Video, every: int) -> list[int]:
    """Positions of a capture's views that are searched for changes."""
    return [k for k, v in enumerate(geometry.views) if v.video == video and v.index % every == 0]


def model(
    geometry: Geometry,
    video: Video,
    config: ModelConfig,
    workspace: Path,
    progress: Progress = silent,
) -> Gaussians:
    """Gaussians of one capture; its state lies in the workspace, and is continued from there."""
    ids = [k for k, v in enumerate(geometry.views) if v.video == video]
    points = Points.of(geometry, ids, config.points)
    learned = config.train
    if not points.dense:  # a few points of structure from motion have to become many
        learned = replace(learned, densify=TrainConfig().densify)
    return train(
        [geometry.views[k] for k in ids],
        points,
        learned,
        checkpoint=workspace / f"{video}.gaussians",
        progress=lambda p: progress(f"{video} model", p.iteration, p.iterations),
    ).gaussians


def completed(
    reference: Gaussians, geometry: Geometry, now: Sequence[int], config: ModelConfig
) -> Gaussians:
    """The model with Gaussians where the other capture has surfaces and the model has nothing near.

    Without them, a new thing could only be painted on what lies behind it.

    Parameters
    ----------
    now : sequence of int
        Positions of the other capture's views.
    """
    points = Points.of(geometry, list(now), config.points)
    if not points.dense or len(points.xyz) < 4:
        return reference
    spacing = np.median(KDTree(points.xyz).query(points.xyz, k=2)[0][:, 1])
    gap = KDTree(reference.means.cpu().numpy()).query(points.xyz)[0]
    new = gap > NEW * spacing
    if new.sum() < 4:
        return reference
    added = Gaussians.start(replace(points, xyz=points.xyz[new], rgb=points.rgb[new]), 0)
    terms = reference.sh.shape[1]
    sh = torch.zeros(len(added), terms, 3)
    sh[:, :1] = added.sh
    added = replace(added, sh=sh)
    both = (torch.cat([a.cpu(), b]) for a, b in zip(
        vars(reference).values(), vars(added).values(), strict=True
    ))  # fmt: skip
    return Gaussians(*both)


def renders(gaussians: Gaussians, views: Sequence[View]) -> list[Render]:
    """The model from the cameras of the views."""
    out = []
    for view in views:
        with torch.no_grad():
            drawn = render(gaussians, PinholeCamera.of(view))
        image = np.rint(drawn.rgb.cpu().numpy().clip(0, 1) * 255).astype(np.uint8)
        depth = drawn.depth.cpu().numpy().astype(np.float32)
        out.append(Render(image, depth, drawn.alpha.cpu().numpy().astype(np.float32)))
    return out
