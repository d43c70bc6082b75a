"""What can be wrong with a pair's folder, found without stopping at the first fault."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from PIL import Image, UnidentifiedImageError

from scenediff_classic import masks
from scenediff_classic.dataset import SAMPLE_STEP, AnnotatedPair, read_annotations
from scenediff_classic.errors import InputError
from scenediff_classic.types import VIDEOS, Video

PICTURES = (".png", ".jpg", ".jpeg")
Size = tuple[int, int]
"""Height, width."""


def picture_files(folder: Path) -> list[Path]:
    """Pictures in a folder, by name."""
    if not folder.is_dir():
        return []
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in PICTURES)


def picture_size(path: Path) -> Size | None:
    """Size from the picture's head; None if it cannot be read."""
    try:
        with Image.open(path) as picture:
            return picture.height, picture.width
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError):
        return None


def picture_sizes(folder: Path) -> list[Size]:
    """Sizes of the pictures in a folder that can be read, by name."""
    return [size for p in picture_files(folder) if (size := picture_size(p)) is not None]


def mask_problems(
    folder: Path, sizes: Mapping[Video, Sequence[Size]], *, whole: bool = True
) -> Iterator[str]:
    """What is wrong with a pair's truth in masks.

    Parameters
    ----------
    folder : Path
        Of ``segments.json`` or ``segments.pkl``.
    sizes : mapping
        Size of each sampled frame of each capture; empty if they are not known.
    whole : bool
        Whether all frames are in `sizes`; otherwise the last one stands for those that follow.
    """
    try:
        truth = read_annotations(folder)
    except InputError as error:
        yield str(error)
        return
    for video in VIDEOS:
        yield from _misfits(folder, truth, video, sizes.get(video, ()), whole)
    known = {item.object_id for item in truth.objects}
    for item in truth.objects:
        name = f"{folder}: object {item.object_id} '{item.label}'"
        if item.kind is None:
            yield f"{name} is flagged in neither capture, and does not count."
        for video in VIDEOS:
            track = truth.track(video, item.object_id)
            if item.present(video) and (track is None or not track.masks):
                yield f"{name} is flagged in {video} and has no mask there."
            elif item.present(video) and track and not any(_sampled(m.frame) for m in track.masks):
                yield f"{name} has masks in {video}, but none at a sampled frame (30, 60, …)."
    for track in truth.tracks:
        if track.object_id not in known:
            name = f"{folder}: masks of object {track.object_id}"
            yield f"{name} in {track.video} belong to no object."


def _misfits(
    folder: Path, truth: AnnotatedPair, video: Video, sizes: Sequence[Size], whole: bool
) -> Iterator[str]:
    """Masks of a wrong size, empty ones, and masks after the end, one sentence for each object."""
    for track in (t for t in truth.tracks if t.video == video):
        name = f"{folder}: object {track.object_id} in {video}"
        empty = [m.frame for m in track.masks if not masks.area(m.mask)]
        if empty:
            yield f"{name} has masks without a pixel, the first at frame {empty[0]}."
        if not sizes:
            continue
        late = [m.frame for m in track.masks if m.frame >= SAMPLE_STEP * len(sizes)]
        if late and whole:
            yield f"{name} has masks after the capture's end, the first at frame {late[0]}."
        for annotated in track.masks:
            place = min(annotated.frame // SAMPLE_STEP, len(sizes) - 1)
            size = (int(annotated.mask.size[0]), int(annotated.mask.size[1]))
            if size != sizes[place]:
                yield (
                    f"{name} has a mask of {_times(size)} pixels at frame {annotated.frame}, "
                    f"where the picture has {_times(sizes[place])}."
                )
                break


def _sampled(frame: int) -> bool:
    return frame % SAMPLE_STEP == 0


def _times(size: Size) -> str:
    return f"{size[1]}x{size[0]}"
