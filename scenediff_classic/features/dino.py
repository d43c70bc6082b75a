"""Learned features, as in the paper: patch tokens of DINOv2 or DINOv3."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from scenediff_classic.devices import Device
from scenediff_classic.types import View
from scenediff_classic.weights import Weights, find_weights

_CLASSES = {
    "dinov2": "Dinov2Model",
    "dinov2_with_registers": "Dinov2WithRegistersModel",
    "dinov3_vit": "DINOv3ViTModel",
}


@dataclass(frozen=True)
class DinoFeatures:
    """Patch features of a DINOv2 or DINOv3 vision transformer.

    The picture is resized to a whole number of patches, so that the grid covers all of it; the
    model's class and register tokens, which stand for no place, are left out. Every picture is
    encoded by itself. The model is loaded at the first picture and kept with this object.
    """

    weights: str
    """Folder, or model id in the user's Hugging Face cache (see `weights.find_weights`)."""
    device: Device = "auto"
    similarity: float = 0.7
    """The paper's tau_sim, chosen for DINOv3 on its validation set."""
    merge: float = 1.4
    """The paper's sigma_merge, likewise."""
    long_cells: int = 64
    """Patches along the picture's longer side. Time and memory grow with its square and more,
    whatever the picture's size."""

    def __call__(self, view: View) -> Float32[np.ndarray, "h w c"]:
        """Unit-length features, one per patch.

        Raises
        ------
        InputError
            If the weights cannot be used (see `weights.Weights`).
        """
        import torch

        model, device = self._model
        rows, columns = grid_shape(view.shape, self.long_cells)
        patch = model.config.patch_size
        pixels = self.source.preprocessing(view.image, rows * patch, columns * patch)
        with torch.inference_mode():
            tokens = model(torch.from_numpy(pixels)[None].to(device)).last_hidden_state[0]
            places = tokens[-rows * columns :]  # class and register tokens come first
            unit = torch.nn.functional.normalize(places, dim=-1).cpu().numpy()
        return unit.reshape(rows, columns, -1)

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that decide the features."""
        return self.source.files

    @cached_property
    def source(self) -> Weights:
        """The folder behind `weights`, checked but not loaded."""
        return Weights(find_weights(self.weights), _CLASSES)

    @cached_property
    def _model(self) -> tuple[Any, str]:
        return self.source.load(self.device)


def grid_shape(shape: tuple[int, int], long_cells: int) -> tuple[int, int]:
    """(rows, columns) of cells as nearly square as can be, `long_cells` along the longer side."""
    cell = max(shape) / long_cells
    height, width = shape
    return max(round(height / cell), 1), max(round(width / cell), 1)
