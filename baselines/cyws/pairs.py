"""Two-view pairs for training and judging: two pictures, their geometry, boxes in both."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float32, Float64, UInt8
from torch import Tensor

from baselines.cyws.registration import Registration, affine_2d, known_geometry
from baselines.cyws.scenes import SceneFrames

LEAST_PIXELS = 20
"""Of a site in either picture, for a pair to have it as a change."""


@dataclass(frozen=True)
class TwoViews:
    """A pair with its truth.

    Sizes are those of the pictures; a place without depth is NaN.
    """

    images: UInt8[np.ndarray, "2 h w 3"]
    depth: Float32[np.ndarray, "2 h w"]
    intrinsics: Float64[np.ndarray, "2 3 3"]
    cam_from_world: Float64[np.ndarray, "2 4 4"]
    boxes: Float32[np.ndarray, "n 2 4"]
    """Of every change, in the first picture and in the second; without width: none there."""
    across_2d: Float64[np.ndarray, "2 3"] | None = None
    """Of a pair of one flat picture: where places (0 to 1) of the first lie in the second."""

    @property
    def turn(self) -> float:
        """Degrees between the two viewing directions."""
        one, two = self.cam_from_world[:, 2, :3]
        return float(np.degrees(np.arccos(np.clip(one @ two, -1, 1))))


def pair_of(scene: SceneFrames, first: int, second: int) -> TwoViews:
    """Two frames of a scene; without any change if they are of one capture."""
    ends = [first, second]
    changed = scene.video[first] != scene.video[second]
    seen = (scene.pixels[:, ends] >= LEAST_PIXELS).all(1) & changed
    return TwoViews(
        scene.images[ends],
        scene.depth[ends],
        scene.intrinsics[ends],
        scene.cam_from_world[ends],
        scene.boxes[seen][:, ends],
    )


def judged_pairs(
    scenes: Sequence[SceneFrames], per_scene: int = 4, seed: int = 0
) -> list[TwoViews]:
    """The same pairs every time: frames of either capture, drawn without repetition."""
    out = []
    for number, scene in enumerate(scenes):
        rng = np.random.default_rng([seed, number])
        before, after = (np.flatnonzero(scene.video == v) for v in (0, 1))
        every = [(int(a), int(b)) for a in before for b in after]
        for k in rng.permutation(len(every))[:per_scene]:
            out.append(pair_of(scene, *every[k]))
    return out


def drawn_pair(scenes: Sequence[SceneFrames], rng: np.random.Generator) -> TwoViews:
    """A random pair for training, either capture first; one in twelve of one capture alone."""
    scene = scenes[int(rng.integers(len(scenes)))]
    first = int(rng.integers(len(scene.video)))
    same = scene.video == scene.video[first]
    if rng.uniform() < 1 / 12:
        others = np.flatnonzero(same & (np.arange(len(same)) != first))
    else:
        others = np.flatnonzero(~same)
    return pair_of(scene, first, int(rng.choice(others)))


# --- augmentation -------------------------------------------------------------------------------


def augmented(pair: TwoViews, rng: np.random.Generator) -> TwoViews:
    """Mirrored half of the time, other colours in either picture, noise in depth and pose."""
    if rng.uniform() < 0.5:
        pair = mirrored(pair)
    images = np.stack([jittered_colour(image, rng) for image in pair.images])
    depth = np.stack([noisy_depth(d, rng) for d in pair.depth])
    poses = pair.cam_from_world.copy()
    poses[1] = _tremble(rng) @ poses[1]
    return replace(pair, images=images, depth=depth, cam_from_world=poses)


def mirrored(pair: TwoViews) -> TwoViews:
    """As seen in a mirror, with the cameras and boxes that belong to it."""
    width = pair.images.shape[2]
    flip = np.diag([-1.0, 1, 1, 1])
    intrinsics = pair.intrinsics.copy()
    intrinsics[:, 0, 2] = width - intrinsics[:, 0, 2]
    boxes = pair.boxes.copy()
    boxes[..., [0, 2]] = width - boxes[..., [2, 0]]
    return replace(
        pair,
        images=np.ascontiguousarray(pair.images[:, :, ::-1]),
        depth=np.ascontiguousarray(pair.depth[:, :, ::-1]),
        intrinsics=intrinsics,
        cam_from_world=flip @ pair.cam_from_world @ flip,
        boxes=boxes,
    )


def jittered_colour(
    image: UInt8[np.ndarray, "h w 3"], rng: np.random.Generator, strength: float = 0.1
) -> UInt8[np.ndarray, "h w 3"]:
    """Brightness, contrast, saturation and hue (as gains of the channels) changed a little."""
    x = image.astype(np.float32)
    x *= np.float32(1 + rng.uniform(-strength, strength))
    mean = x.mean()
    x = mean + (x - mean) * np.float32(1 + rng.uniform(-strength, strength))
    grey = x.mean(axis=2, keepdims=True)
    x = grey + (x - grey) * np.float32(1 + rng.uniform(-strength, strength))
    x *= (1 + rng.uniform(-strength / 2, strength / 2, 3)).astype(np.float32)
    return np.clip(np.rint(x), 0, 255).astype(np.uint8)


def noisy_depth(
    depth: Float32[np.ndarray, "h w"], rng: np.random.Generator, share: float = 0.015
) -> Float32[np.ndarray, "h w"]:
    """Off by a smooth field of about 1.5 %, half of that again in single pixels; a few holes."""
    height, width = depth.shape
    coarse = rng.normal(0, share, (5, 6)).astype(np.float32)
    field = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    grain = rng.normal(0, share / 2, depth.shape).astype(np.float32)
    out = depth * (1 + field + grain)
    for _ in range(int(rng.integers(0, 4))):
        high, wide = rng.integers(3, height // 4), rng.integers(3, width // 4)
        row, column = rng.integers(0, height - high), rng.integers(0, width - wide)
        out[row : row + high, column : column + wide] = np.nan
    return out


def _tremble(rng: np.random.Generator, degrees: float = 0.3, metres: float = 0.01) -> np.ndarray:
    out = np.eye(4)
    turn = np.radians(rng.normal(0, degrees, 3))
    out[:3, :3] = cv2.Rodrigues(turn)[0]
    out[:3, 3] = rng.normal(0, metres, 3)
    return out


# --- batches ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Batch:
    """Pairs of one size as tensors, with the pairs they are."""

    images: Tensor
    """(b, 2, 3, h, w), RGB from 0 to 1."""
    registration: Registration
    pairs: tuple[TwoViews, ...]

    def boxes(self) -> list[Float32[np.ndarray, "_ 4"]]:
        """Of all 2b pictures, in the order of the networks' maps."""
        sides = [pair.boxes[:, k] for pair in self.pairs for k in (0, 1)]
        return [boxes[boxes[:, 2] > boxes[:, 0]] for boxes in sides]


def batched(pairs: Sequence[TwoViews]) -> Batch:
    """Stack pairs whose pictures have one size."""
    images = torch.from_numpy(np.stack([p.images for p in pairs]))
    geometry = known_geometry(
        torch.from_numpy(np.stack([p.depth for p in pairs])),
        np.stack([p.intrinsics for p in pairs]),
        np.stack([p.cam_from_world for p in pairs]),
    )
    for k, pair in enumerate(pairs):
        if pair.across_2d is not None:
            flat = affine_2d(pair.across_2d[None], *pair.depth.shape[1:])
            geometry.across[k] = flat.across[0]
    # channels first in memory too: with channels last, PyTorch 2.13's convolutions crash on CPUs
    # without AVX-512 where a width is no multiple of 8
    images = images.permute(0, 1, 4, 2, 3).contiguous()
    return Batch(images.float() / 255, geometry, tuple(pairs))


def in_batches(pairs: Sequence[TwoViews], size: int) -> Iterator[Batch]:
    """One after another, the last one shorter."""
    for start in range(0, len(pairs), size):
        yield batched(pairs[start : start + size])
