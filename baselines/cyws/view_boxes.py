"""Boxes of every view of a geometry, from all pairs of views, each with its partner."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from baselines.cyws.boxes import (
    PAIRED,
    Boxes,
    BoxPair,
    Corners,
    corners_of,
    decode,
    filtered,
    pair_boxes,
    survivors,
)
from baselines.cyws.pairs import batched
from baselines.cyws.presets import Preset
from baselines.cyws.view_pairs import two_views
from scenediff_classic.protocols import Progress, silent
from scenediff_classic.types import Geometry


@dataclass(frozen=True)
class PartnerBox:
    """Where the other capture's view of a pair has the same change."""

    view: int
    """Position in `Geometry.views`."""
    xyxy: Corners
    """Pixels of that view."""


@dataclass(frozen=True)
class FoundBox:
    """A box of one view."""

    xyxy: Corners
    """Pixels of the view."""
    score: float
    partner: PartnerBox | None
    """None where nothing in the other view was paired with it."""


def view_boxes(
    network: torch.nn.Module,
    preset: Preset,
    geometry: Geometry,
    pairs: Sequence[tuple[int, int]],
    least: float = PAIRED,
    device: str = "cpu",
    progress: Progress = silent,
) -> list[tuple[FoundBox, ...]]:
    """Boxes of every view from all its pairs, each change once, the best first.

    Of boxes that overlap, that of the surest pair of views stays, with its partner in that pair.

    Parameters
    ----------
    least : float
        Score above which boxes are kept and paired.
    """
    network = network.to(device).eval()
    size = preset.height, preset.width
    found: list[list[FoundBox]] = [[] for _ in geometry.views]
    for done, pair in enumerate(pairs):
        first, second = (geometry.views[k] for k in pair)
        batch = batched([two_views(first, second, *size)])
        with torch.inference_mode():
            maps = network(batch.images.to(device), batch.registration.to(device))
        tidy = [filtered(boxes, *size) for boxes in decode(maps, *size)]
        partners = _partners(pair_boxes(tidy[0], tidy[1], size, size, batch.registration, 0, least))
        enlarged = [_enlarger(geometry.views[k].shape, size) for k in pair]
        for side, k in enumerate(pair):
            for row in np.flatnonzero(tidy[side].score > least).tolist():
                own = corners_of(tidy[side], row)
                other = partners[side].get(own)
                partner = (
                    None if other is None else PartnerBox(pair[1 - side], enlarged[1 - side](other))
                )
                score = float(tidy[side].score[row])
                found[k].append(FoundBox(enlarged[side](own), score, partner))
        progress("boxes", done + 1, len(pairs))
    return [_once(boxes) for boxes in found]


def _partners(pairs: Sequence[BoxPair]) -> tuple[dict[Corners, Corners], dict[Corners, Corners]]:
    """Box -> box of the other picture, from the first to the second and back."""
    both = [(p.first, p.second) for p in pairs if p.first and p.second]
    return dict(both), {b: a for a, b in both}


def _enlarger(shape: tuple[int, int], size: tuple[int, int]) -> Callable[[Corners], Corners]:
    """From the network's pixels to those of a view; both sizes are (height, width)."""
    y, x = (float(s / n) for s, n in zip(shape, size, strict=True))
    return lambda box: (box[0] * x, box[1] * y, box[2] * x, box[3] * y)


def _once(boxes: Sequence[FoundBox]) -> tuple[FoundBox, ...]:
    table = Boxes(
        np.array([b.xyxy for b in boxes], np.float32).reshape(-1, 4),
        np.array([b.score for b in boxes], np.float32),
    )
    return tuple(boxes[row] for row in survivors(table))
