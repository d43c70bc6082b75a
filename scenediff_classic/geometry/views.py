"""From a frame and its camera to a `View`: the step that all sources of geometry share."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Float32, Float64

from scenediff_classic.cameras import (
    pixel_centres,
    sample,
    scale_intrinsics,
    source_from_view,
    undistort,
)
from scenediff_classic.errors import InputError
from scenediff_classic.types import (
    VIDEOS,
    Capture,
    Frame,
    Geometry,
    Lens,
    SparsePoints,
    Unregistered,
    View,
)


def resize_lens(lens: Lens, width: int, height: int) -> Lens:
    """The same lens, for the same picture at another size."""
    k = scale_intrinsics(lens.intrinsics, width / lens.width, height / lens.height)
    return Lens(width, height, k, lens.distortion)


def working_shape(frame: Frame, long_side: int) -> tuple[int, int]:
    """(height, width) of a frame's view: its own aspect, never larger than its pixels."""
    side = min(long_side, max(frame.image.shape[:2]))
    scale = side / max(frame.width, frame.height)
    return max(round(frame.height * scale), 1), max(round(frame.width * scale), 1)


def make_view(
    frame: Frame,
    lens: Lens,
    cam_from_world: Float64[np.ndarray, "4 4"],
    long_side: int,
    depth: Float[np.ndarray, "hd wd"] | None = None,
    confidence: Float[np.ndarray, "hd wd"] | None = None,
) -> View:
    """Undistort a frame and carry its depth along.

    Parameters
    ----------
    lens : Lens
        The camera of the frame's *input* picture.
    long_side : int
        Longer side of the view, in pixels (smaller if the frame is).
    depth : array (hd, wd), optional
        z-depth over the whole input picture, at any resolution and still distorted like it;
        unknown where it is not finite and positive. It is never interpolated.
    confidence : array (hd, wd), optional
        Trust in `depth`, 0 to 1; 1 if not given.
    """
    height, width = working_shape(frame, long_side)
    intrinsics = resize_lens(lens, width, height).intrinsics
    image, outside = undistort(frame.image, lens, intrinsics, height, width)
    ignore = outside
    if frame.ignore is not None:
        dynamic, _ = undistort(frame.ignore.astype(np.float32), lens, intrinsics, height, width)
        ignore = outside | (dynamic > 0.5)
    depth_here = np.full((height, width), np.nan, np.float32)
    trust = np.zeros((height, width), np.float32)
    if depth is not None:
        depth_here = _carry(depth, lens, intrinsics, (height, width))
        depth_here[~(depth_here > 0) | np.isinf(depth_here)] = np.nan
        known = np.ones(depth.shape, np.float32) if confidence is None else confidence
        trust = np.clip(np.nan_to_num(_carry(known, lens, intrinsics, (height, width))), 0, 1)
        trust[np.isnan(depth_here)] = 0
    return View(
        video=frame.video,
        index=frame.index,
        name=frame.name,
        image=image,
        intrinsics=intrinsics,
        cam_from_world=cam_from_world,
        depth=depth_here,
        confidence=trust,
        measured=np.isfinite(depth_here),
        ignore=ignore,
        lens=lens,
    )


def assemble(
    before: Capture,
    after: Capture,
    view_of: Callable[[Frame], View | None],
    reason: str,
    source: str,
) -> Geometry:
    """Views of all frames that a source of known geometry has a camera for.

    Parameters
    ----------
    view_of : callable
        The frame's view, or None if the source does not know the frame.
    reason : str
        Why a frame without a camera is left out.
    source : str
        Named in the error if a whole capture is unknown.
    """
    frames = (*before.frames, *after.frames)
    views = {(frame.video, frame.index): view_of(frame) for frame in frames}
    known = tuple(view for view in views.values() if view is not None)
    for video in VIDEOS:
        if not any(view.video == video for view in known):
            raise InputError(f"{source} has no camera for any frame of the {video} capture.")
    missing = tuple(
        Unregistered(frame.video, frame.index, reason)
        for frame in frames
        if views[frame.video, frame.index] is None
    )
    log = (f"Cameras and depth read from {source}.",)
    return Geometry(known, SparsePoints.none(), missing, log=log)


def _carry(
    values: Float[np.ndarray, "hd wd"],
    lens: Lens,
    intrinsics: Float64[np.ndarray, "3 3"],
    shape: tuple[int, int],
) -> Float32[np.ndarray, "h w"]:
    """Nearest value of a map over the input picture, seen in the undistorted view."""
    xy = source_from_view(pixel_centres(*shape), lens, intrinsics)
    scale = np.array([values.shape[1] / lens.width, values.shape[0] / lens.height])
    # Halving a map puts every sample on the corner of four pixels: a shade less, and all such
    # ties fall the same way instead of by rounding noise.
    return sample(values.astype(np.float32), xy * scale - 1e-6, nearest=True)
