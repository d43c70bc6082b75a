"""Outlines of changed objects, drawn anew where the picture itself has edges.

Not in the paper, whose regions come from a learned segmenter. Regions from depth and colour stop
short of an object's border or run over it by a few pixels; once it is known which regions changed,
the colours on either side tell the border better.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from scenediff_classic.change.objects import SceneObject
from scenediff_classic.types import Geometry, View


@dataclass(frozen=True)
class OutlineConfig:
    """How far outlines may move; lengths relative to an object's size (square root of its area)."""

    reach: float = 0.15
    """Farthest distance outside the old outline."""
    core: float = 0.06
    """Deeper inside than this, pixels stay with the object."""
    rounds: int = 3
    """Of colour models and cuts (GrabCut); 0 keeps the regions' outlines, as in the paper."""
    most: float = 2.0
    """A new outline that holds so many times as many pixels, or so many times fewer, is refused."""


def redrawn(
    objects: Sequence[SceneObject], geometry: Geometry, config: OutlineConfig
) -> list[SceneObject]:
    """The objects with a new outline in each view; which regions they are made of stays."""
    if config.rounds == 0:
        return list(objects)
    return [_redrawn(item, geometry, config) for item in objects]


def _redrawn(item: SceneObject, geometry: Geometry, config: OutlineConfig) -> SceneObject:
    regions = list(item.regions)
    for k in sorted({r.view for r in regions}):
        here = [n for n, r in enumerate(regions) if r.view == k]
        old = np.logical_or.reduce([regions[n].mask for n in here])
        new = outline(old, geometry.views[k], config)
        largest = max(here, key=lambda n: (regions[n].area, -n))
        for n in here:  # what is gained goes to the largest part
            mask = regions[n].mask & new
            regions[n] = replace(regions[n], mask=mask | (new & ~old) if n == largest else mask)
    return replace(item, regions=tuple(r for r in regions if r.mask.any()))


def outline(
    mask: Bool[np.ndarray, "h w"], view: View, config: OutlineConfig
) -> Bool[np.ndarray, "h w"]:
    """The mask, cut anew in a band around its border by GrabCut (Rother et al. 2004).

    Returns
    -------
    The new mask; the old one where the colours cannot tell object and surroundings apart.
    """
    size = float(np.count_nonzero(mask)) ** 0.5
    reach, core = max(2, round(config.reach * size)), max(1, round(config.core * size))
    window = _window(mask, 3 * reach + 4)
    old = mask[window].astype(np.uint8)
    trimap = np.full(old.shape, cv2.GC_BGD, np.uint8)
    trimap[cv2.dilate(old, _disc(reach)) > 0] = cv2.GC_PR_BGD
    trimap[old > 0] = cv2.GC_PR_FGD
    trimap[cv2.erode(old, _disc(core)) > 0] = cv2.GC_FGD
    trimap[view.ignore[window]] = cv2.GC_BGD
    if not _has_both_sides(trimap):
        return mask
    picture = np.ascontiguousarray(view.image[window][..., ::-1])
    cv2.setRNGSeed(0)  # its colour models start from random centres
    cv2.grabCut(
        picture, trimap, (0, 0, 0, 0), np.zeros((1, 65)), np.zeros((1, 65)), config.rounds,
        cv2.GC_INIT_WITH_MASK,
    )  # fmt: skip
    new = _touching((trimap == cv2.GC_FGD) | (trimap == cv2.GC_PR_FGD), old > 0)
    if not 1 / config.most <= np.count_nonzero(new) / np.count_nonzero(old) <= config.most:
        return mask
    result = np.zeros_like(mask)
    result[window] = new
    return result


def _window(mask: Bool[np.ndarray, "h w"], margin: int) -> tuple[slice, slice]:
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    return (
        slice(max(rows[0] - margin, 0), rows[-1] + margin + 1),
        slice(max(columns[0] - margin, 0), columns[-1] + margin + 1),
    )


def _disc(radius: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))


def _has_both_sides(trimap: UInt8[np.ndarray, "h w"]) -> bool:
    """GrabCut fits five colours to either side and needs some pixels of each."""
    object_pixels = int(np.count_nonzero(trimap & 1))
    return object_pixels >= 10 and trimap.size - object_pixels >= 10


def _touching(new: np.ndarray, old: np.ndarray) -> Bool[np.ndarray, "h w"]:
    """The pieces of `new` that share a pixel with `old`."""
    _, pieces = cv2.connectedComponents(new.astype(np.uint8))
    return new & np.isin(pieces, np.unique(pieces[old & new]))
