"""What the head is to say of a picture with given boxes, and how far off it is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from baselines.cyws.decoder import HeadMaps

OVERLAP = 0.3
"""IoU that a box shifted by the radius keeps at least."""
ALPHA, GAMMA = 2, 4
"""Powers of the focal loss."""
SIZE_WEIGHT = 0.1


@dataclass(frozen=True)
class Targets:
    """The head's maps as they should be; sizes and offsets count where `mask` is true."""

    heat: Float[Tensor, "b 1 h w"]
    size: Float[Tensor, "b 2 h w"]
    offset: Float[Tensor, "b 2 h w"]
    mask: Float[Tensor, "b 1 h w"]
    """1 in cells that hold a centre."""

    def to(self, device: torch.device | str) -> "Targets":
        """The same on a device."""
        return Targets(*(t.to(device) for t in (self.heat, self.size, self.offset, self.mask)))


def radius(width: float, height: float, overlap: float = OVERLAP) -> float:
    """How far both corners of a box may move while its IoU with the old one stays above `overlap`.

    The least over three cases (Law and Deng 2018): both corners move the same way, both inwards,
    both outwards.
    """
    total, area = width + height, width * height

    def root(a: float, b: float, c: float) -> float:
        return (-b + math.sqrt(max(b * b - 4 * a * c, 0.0))) / (2 * a)

    # intersection (w - r)(h - r) of two boxes of the same area: r² - (w+h) r + wh (1-o)/(1+o) = 0
    shift = -root(1, total, area * (1 - overlap) / (1 + overlap))
    # (w - 2r)(h - 2r) = o wh
    shrink = -root(4, 2 * total, (1 - overlap) * area)
    # wh = o (w + 2r)(h + 2r)
    grow = root(4 * overlap, 2 * overlap * total, (overlap - 1) * area)
    return min(shift, shrink, grow)


def encode(
    boxes: Sequence[Float32[np.ndarray, "_ 4"]], height: int, width: int, stride: float
) -> Targets:
    """Targets of a batch.

    Parameters
    ----------
    boxes : sequence of array (n, 4)
        x0, y0, x1, y1 of each picture, in its pixels.
    height, width : int
        Of the head's grid.
    stride : float
        Pixels to a cell.
    """
    shape = (len(boxes), 1, height, width)
    heat, mask = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    size, offset = (np.zeros((len(boxes), 2, height, width), np.float32) for _ in range(2))
    rows, columns = np.arange(height)[:, None], np.arange(width)
    for k, found in enumerate(boxes):
        for box in np.asarray(found, np.float64) / stride:
            wide, high = box[2] - box[0], box[3] - box[1]
            x, y = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
            column, row = int(np.clip(x, 0, width - 1)), int(np.clip(y, 0, height - 1))
            reach = max(int(radius(wide, high)), 0)
            sigma = (2 * reach + 1) / 6
            near = (np.abs(rows - row) <= reach) & (np.abs(columns - column) <= reach)
            bell = np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / (2 * sigma**2))
            heat[k, 0] = np.maximum(heat[k, 0], np.where(near, bell, 0))
            mask[k, 0, row, column] = 1
            size[k, :, row, column] = wide, high
            offset[k, :, row, column] = x - column, y - row
    return Targets(*(torch.from_numpy(t) for t in (heat, size, offset, mask)))


def loss(maps: HeadMaps, targets: Targets) -> Float[Tensor, ""]:
    """Focal loss of the centres, L1 of sizes (a tenth) and offsets, per object of the batch."""
    objects = targets.mask.sum().clamp(min=1)
    heat = maps.heat.float()
    yes, no = torch.nn.functional.logsigmoid(heat), torch.nn.functional.logsigmoid(-heat)
    chance = heat.sigmoid()
    centre = targets.heat == 1
    hit = (1 - chance) ** ALPHA * yes
    miss = chance**ALPHA * (1 - targets.heat) ** GAMMA * no
    focal = -torch.where(centre, hit, miss).sum() / objects
    size = ((maps.size.float() - targets.size).abs() * targets.mask).sum() / (2 * objects)
    offset = ((maps.offset.float() - targets.offset).abs() * targets.mask).sum() / (2 * objects)
    return focal + SIZE_WEIGHT * size + offset
