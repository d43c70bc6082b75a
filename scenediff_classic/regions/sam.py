"""Learned regions, as in the paper: masks of SAM or SAM 2, prompted by a grid of points."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float16, Float32, UInt8

from scenediff_classic.devices import Device
from scenediff_classic.types import Regions, View
from scenediff_classic.weights import Weights, find_weights

_CLASSES = {"sam": "SamModel", "sam2": "Sam2Model", "sam2_video": "Sam2Model"}
"""SAM 2 is published as a video model; its image part is all that is needed."""

_MIN_SCORE = {"sam": 0.88, "sam2": 0.8, "sam2_video": 0.8}


@dataclass(frozen=True)
class Proposals:
    """Masks as the model draws them: coarse, and possibly overlapping."""

    logits: Float16[np.ndarray, "n a b"]
    """Above 0 inside."""
    scores: Float32[np.ndarray, "n"]
    """Intersection over union with the thing meant, as the model foresees it."""
    extent: tuple[float, float]
    """Rows and columns of `logits` that the picture covers: the last ones perhaps in part."""


@dataclass(frozen=True)
class SamRegions:
    """Automatic masks of SAM or SAM 2, made non-overlapping: a whole hides its parts.

    Each point of a regular grid prompts three masks (part, whole, ...). Those that the model
    trusts and that hardly depend on the exact level at which they are cut are kept; of nearly
    equal ones, the best. The model is loaded at the first picture and kept with this object.
    """

    weights: str
    """Folder, or model id in the user's Hugging Face cache (see `weights.find_weights`)."""
    device: Device = "auto"
    points_per_side: int = 32
    chunk: int = 64
    """Points per call of the mask decoder: bounds memory, does not change the result."""
    min_score: float | None = None
    """Least foreseen intersection over union; None: what the model's authors use (`_MIN_SCORE`)."""
    min_stability: float = 0.95
    """Least intersection over union of the mask cut at +1 and at -1."""
    max_overlap: float = 0.7
    """Intersection over union above which two masks are the same thing."""
    max_share: float = 0.9
    """Masks of a larger share of the picture are the picture, and no thing in it."""
    min_area: float = 100.0
    """Regions with fewer visible pixels are dropped; pixels of a picture with long side 518."""

    def __call__(self, view: View) -> Regions:
        """Pixels that no mask covers are -1.

        Raises
        ------
        InputError
            If the weights cannot be used (see `weights.Weights`).
        """
        proposals = distinct(self.propose(view.image), self.max_overlap)
        least = self.min_area * (max(view.shape) / 518) ** 2
        return painted(proposals, view.shape, least, self.max_share)

    def propose(self, image: UInt8[np.ndarray, "h w 3"]) -> Proposals:
        """All masks that the model trusts, best first."""
        import torch

        model, device = self._model
        side = int(model.config.prompt_encoder_config.image_size)
        height, width = self._fitted(image.shape[:2], side)
        pixels = np.zeros((3, side, side), np.float32)  # SAM pads, at the right and below
        pixels[:, :height, :width] = self.source.preprocessing(image, height, width)
        found = []
        with torch.inference_mode():
            encoded = model.get_image_embeddings(torch.from_numpy(pixels)[None].to(device))
            for points in self._prompts(height, width):
                prompts = torch.from_numpy(points)[None, :, None].to(device)
                answer = model(
                    image_embeddings=encoded, input_points=prompts, multimask_output=True
                )
                masks = answer.pred_masks[0]
                rows, columns = (
                    n * part / side
                    for n, part in zip(masks.shape[-2:], (height, width), strict=True)
                )
                masks = masks[..., : math.ceil(rows), : math.ceil(columns)]  # without the padding
                found.append(self._trusted(masks, answer.iou_scores[0]))
        logits = np.concatenate([masks for masks, _ in found])
        scores = np.concatenate([scores for _, scores in found])
        best_first = np.argsort(-scores, kind="stable")
        return Proposals(logits[best_first], scores[best_first], (rows, columns))

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that decide the regions."""
        return self.source.files

    @cached_property
    def source(self) -> Weights:
        """The folder behind `weights`, checked but not loaded."""
        return Weights(find_weights(self.weights), _CLASSES)

    @cached_property
    def _model(self) -> tuple[Any, str]:
        return self.source.load(self.device)

    def _fitted(self, shape: tuple[int, int], side: int) -> tuple[int, int]:
        """(height, width) of the picture inside the model's square input."""
        if self.source.kind != "sam":
            return side, side  # SAM 2 stretches
        height, width = (max(int(length * side / max(shape) + 0.5), 1) for length in shape)
        return height, width

    def _prompts(self, height: int, width: int) -> Iterator[Float32[np.ndarray, "n 2"]]:
        """Points (x, y) on a regular grid, chunk by chunk."""
        steps = (np.arange(self.points_per_side) + 0.5) / self.points_per_side
        x, y = np.meshgrid(steps * width, steps * height)
        # the model counts from the centre of the first pixel
        points = (np.stack([x.ravel(), y.ravel()], axis=-1) - 0.5).astype(np.float32)
        for start in range(0, len(points), self.chunk):
            yield points[start : start + self.chunk]

    def _trusted(self, logits: Any, scores: Any) -> tuple[np.ndarray, np.ndarray]:
        """Of one chunk's (points, 3) masks and scores, those that are not in doubt."""
        logits, scores = logits.flatten(0, 1), scores.flatten()
        least = _MIN_SCORE[self.source.kind] if self.min_score is None else self.min_score
        inner, outer = ((logits > level).sum((1, 2)) for level in (1, -1))
        use = (scores >= least) & (inner >= self.min_stability * outer) & (inner > 0)
        return logits[use].clamp(-1e3, 1e3).half().cpu().numpy(), scores[use].float().cpu().numpy()


def distinct(proposals: Proposals, max_overlap: float) -> Proposals:
    """Non-maximum suppression: the masks that overlap no better one too much, best first."""
    inside = proposals.logits.reshape(-1, math.prod(proposals.logits.shape[1:])) > 0
    sizes = inside.sum(axis=1)
    bits = np.packbits(inside, axis=1)
    left = np.arange(len(sizes))
    kept = []
    while len(left):
        best, left = left[0], left[1:]
        kept.append(best)
        common = np.bitwise_count(bits[left] & bits[best]).sum(axis=1, dtype=np.int64)
        left = left[common <= max_overlap * (sizes[left] + sizes[best] - common)]
    chosen = np.array(kept, int)
    return Proposals(proposals.logits[chosen], proposals.scores[chosen], proposals.extent)


def painted(
    proposals: Proposals, shape: tuple[int, int], min_area: float, max_share: float
) -> Regions:
    """Lay masks over each other, the largest on top, and number what can be seen of them.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the picture.
    min_area : float
        Least number of visible pixels.
    max_share : float
        Masks of a larger share of the picture are left out.
    """
    count = len(proposals.scores)
    shares = (proposals.logits > 0).mean(axis=(1, 2)) if count else np.zeros(0)
    canvas = np.full(shape, count, np.int32)
    for k in np.argsort(shares, kind="stable"):
        if shares[k] <= max_share:
            canvas[in_pixels(proposals.logits[k], proposals.extent, shape)] = k
    visible = np.bincount(canvas.ravel(), minlength=count + 1)[:count]
    shown = np.flatnonzero(visible >= max(min_area, 1))
    names = np.full(count + 1, -1, np.int32)
    names[shown] = np.arange(len(shown))
    return Regions(names[canvas], len(shown))


def in_pixels(
    logits: Float[np.ndarray, "a b"], extent: tuple[float, float], shape: tuple[int, int]
) -> Bool[np.ndarray, "h w"]:
    """The mask in the picture's own pixels, by linear interpolation of the logits."""
    rows, columns = (
        ((np.arange(n) + 0.5) * (e / n) - 0.5).astype(np.float32)
        for n, e in zip(shape, extent, strict=True)
    )
    x, y = np.meshgrid(columns, rows)
    fine = cv2.remap(
        logits.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return fine > 0
