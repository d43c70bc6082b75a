"""The thing in a box by SAM or SAM 2, as published; an option."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from baselines.splat_change.segmenting import Box, Segment
from scenediff_classic.devices import Device
from scenediff_classic.regions.sam import SamRegions, in_pixels
from scenediff_classic.weights import Weights


@dataclass(frozen=True)
class SamBoxes:
    """One mask for a box; the score is the overlap with the thing meant that the model foresees."""

    weights: str
    """Folder, or model id in the user's Hugging Face cache (see `weights.find_weights`)."""
    device: Device = "auto"
    least: float = 0.95
    """As published."""

    def __call__(self, image: UInt8[np.ndarray, "h w 3"], box: Box) -> Segment:
        """The thing in the box.

        Raises
        ------
        InputError
            If the weights cannot be used (see `weights.Weights`).
        """
        import torch

        model, device = self._model
        side = int(model.config.prompt_encoder_config.image_size)
        shape = image.shape[0], image.shape[1]
        height, width = side, side  # SAM 2 stretches
        if self.source.kind == "sam":
            height, width = (max(int(n * side / max(shape) + 0.5), 1) for n in shape)
        pixels = np.zeros((3, side, side), np.float32)  # SAM pads, at the right and below
        pixels[:, :height, :width] = self.source.preprocessing(image, height, width)
        scale = np.array([width / shape[1], height / shape[0]] * 2)
        corners = torch.tensor(np.array(box) * scale, dtype=torch.float32)[None, None]
        with torch.inference_mode():
            answer = model(
                pixel_values=torch.from_numpy(pixels)[None].to(device),
                input_boxes=corners.to(device),
                multimask_output=False,
            )
        logits = answer.pred_masks[0, 0, 0].float().cpu().numpy()
        score = float(answer.iou_scores[0, 0, 0])
        rows, columns = (
            n * part / side for n, part in zip(logits.shape, (height, width), strict=True)
        )
        kept = logits[: math.ceil(rows), : math.ceil(columns)]  # without the padding
        mask = in_pixels(kept, (rows, columns), shape)
        return Segment(mask, float(np.clip(score, 0, 1)) if mask.any() else 0.0)

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that decide the masks."""
        return self.source.files

    @cached_property
    def source(self) -> Weights:
        """The folder behind `weights`, checked but not loaded."""
        return SamRegions(self.weights).source

    @cached_property
    def _model(self) -> tuple[Any, str]:
        return self.source.load(self.device)
