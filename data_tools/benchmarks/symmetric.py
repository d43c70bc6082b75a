"""All that changed, as seen from the after views, whichever capture holds it.

Benchmarks with one mask for each after picture ask for it: what a method found in the before
capture is carried into every after view through depth and cameras of the run's own geometry, and
joined with what it found there.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool

from data_tools.benchmarks.truth_pictures import read_mask_picture
from scenediff_classic import masks
from scenediff_classic.cameras import (
    inside,
    mask_to_source,
    pixel_centres,
    project,
    scale_intrinsics,
    source_from_view,
    unproject,
)
from scenediff_classic.dataset import Picture, Prediction, find_prediction, read_prediction
from scenediff_classic.errors import InputError
from scenediff_classic.geometry.checked import read_npz
from scenediff_classic.types import Lens, Rle, Video, View

BEHIND = 1.05
"""What lies farther away than this times the depth that an after view shows there is hidden."""
Masks = dict[int, Rle]
"""Sampled after frame -> what changed, at the size of the input picture."""


def symmetric_masks(run: Path) -> tuple[dict[int, str], Masks]:
    """Names of a run's after pictures, and what changed in each of them.

    Masks that a method wrote itself (``symmetric/after_0000.png``) are preferred.

    Raises
    ------
    InputError
        The run's result cannot be read.
    """
    path = find_prediction(run)
    prediction = Prediction(()) if path is None else read_prediction(path)
    pictures = {p.index: p for p in prediction.pictures if p.video == "after"}
    names = {index: Path(p.name).name for index, p in pictures.items()}
    views = {view.index: view for view in saved_views(run, "after")}
    own = run / "symmetric"
    if own.is_dir():
        found = {
            index: _written(own / f"after_{index:04d}.png", picture, views.get(index))
            for index, picture in pictures.items()
            if (own / f"after_{index:04d}.png").is_file()
        }
        return names, found
    found = {index: np.zeros((p.height, p.width), bool) for index, p in pictures.items()}
    for item in prediction.objects:
        for view in item.views:
            if view.video == "after" and view.frame in found:
                found[view.frame] |= masks.decode(view.mask)
    sources = saved_views(run, "before")
    marks = united(prediction, "before")
    for index, view in views.items():
        if index in found:
            found[index] |= carried(marks, sources, view)
    return names, {index: masks.encode(mask) for index, mask in found.items()}


def united(prediction: Prediction, video: Video) -> dict[int, Bool[np.ndarray, "h w"]]:
    """Frame -> all pixels that any object has there."""
    by_frame: dict[int, list[Rle]] = {}
    for item in prediction.objects:
        for view in item.views:
            if view.video == video:
                by_frame.setdefault(view.frame, []).append(view.mask)
    return {frame: masks.decode(masks.merge(found)) for frame, found in by_frame.items()}


def carried(
    marks: Mapping[int, Bool[np.ndarray, "h w"]], sources: tuple[View, ...], target: View
) -> Bool[np.ndarray, "h w"]:
    """Where marked pixels of some views come to lie in another view's input picture.

    Parameters
    ----------
    marks : mapping
        Frame -> mask at the size of its input picture.
    sources : tuple of View
        Views of the marked capture; frames without a view or depth are left out.
    """
    height, width = target.shape
    hit = np.zeros((height, width), np.uint8)
    for view in sources:
        if view.index not in marks:
            continue
        chosen = working_mask(marks[view.index], view)
        points = unproject(view)[chosen & np.isfinite(view.depth)]
        xy, z = project(points.astype(float), target.intrinsics, target.cam_from_world)
        seen = inside(xy, height, width)
        column, row = xy[seen].astype(int).T
        there = target.depth[row, column]
        shown = ~(z[seen] > BEHIND * there)  # unknown depth hides nothing
        hit[row[shown], column[shown]] = 1
    closed = cv2.morphologyEx(hit, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    return mask_to_source(closed > 0, target.lens, target.intrinsics)


def working_mask(mask: Bool[np.ndarray, "h_in w_in"], view: View) -> Bool[np.ndarray, "h w"]:
    """A mask of the input picture at the view's working size."""
    xy = source_from_view(pixel_centres(*view.shape), view.lens, view.intrinsics)
    scale = np.array([mask.shape[1] / view.lens.width, mask.shape[0] / view.lens.height])
    xy = xy * scale
    out = np.zeros(view.shape, bool)
    valid = inside(xy, *mask.shape)
    column, row = xy[valid].astype(int).T
    out[valid] = mask[row, column]
    return out


def saved_views(run: Path, video: Video) -> tuple[View, ...]:
    """Cameras and depth of a run's registered frames, without their pictures; none if not saved.

    Raises
    ------
    InputError
        The saved geometry is damaged.
    """
    folder = run / "geometry"
    if not (folder / "geometry.json").is_file():
        return ()
    try:
        content = json.loads((folder / "geometry.json").read_text(encoding="utf-8"))
        indices = [int(index) for name, index in content["views"] if name == video]
        return tuple(_view(folder / "depth" / f"{video}_{i:05d}.npz", video, i) for i in indices)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder} does not hold a finished geometry.") from error


def _view(path: Path, video: Video, index: int) -> View:
    arrays = read_npz(path)
    width, height = (int(v) for v in arrays["lens_size"])
    lens = Lens(width, height, arrays["lens_intrinsics"], arrays["lens_distortion"])
    depth = arrays["depth"]
    blank = np.zeros((*depth.shape, 3), np.uint8)
    return View(
        video, index, path.stem, blank, arrays["intrinsics"], arrays["cam_from_world"], depth,
        arrays["confidence"], arrays["measured"], arrays["ignore"], lens,
    )  # fmt: skip


def _written(path: Path, picture: Picture, view: View | None) -> Rle:
    """A mask that a method wrote at its own working size, undistorted."""
    mask = read_mask_picture(path)
    if view is None:
        return masks.resize(masks.encode(mask), picture.height, picture.width)
    high, wide = mask.shape
    lens = scale_intrinsics(view.intrinsics, wide / view.shape[1], high / view.shape[0])
    return masks.encode(mask_to_source(mask, view.lens, lens))
