"""One picture per sampled frame, with the changed objects painted in."""

from pathlib import Path

from scenediff_classic.protocols import Progress, silent
from scenediff_classic.report.drawing import draw_marks, marks_of, stamp
from scenediff_classic.report.embedded import jpeg
from scenediff_classic.types import Capture, ChangeResult
from scenediff_classic.workspace import write_atomic

_QUALITY = 90


def write_overlays(
    result: ChangeResult,
    before: Capture,
    after: Capture,
    folder: Path,
    progress: Progress = silent,
) -> tuple[Path, ...]:
    """Write ``<video>_<index>.jpg`` for every sampled frame.

    Pictures have the size of `Frame.image`; frames without a camera say so in a corner.

    Returns
    -------
    The files, before first, by frame index.

    Raises
    ------
    OutputError
        If a picture cannot be written.
    """
    infos = {"before": result.before, "after": result.after}
    missing = {
        (video, frame.index)
        for video, info in infos.items()
        for frame in info.frames
        if not frame.registered
    }
    frames = (*before.frames, *after.frames)
    written = []
    for done, frame in enumerate(frames):
        progress("overlays", done, len(frames))
        height, width = frame.image.shape[:2]
        marks = marks_of(result, frame.video, frame.index, height, width)
        image = draw_marks(frame.image, marks)
        if (frame.video, frame.index) in missing:
            image = stamp(image, "no camera: frame left out")
        path = folder / f"{frame.video}_{frame.index:05d}.jpg"
        write_atomic(path, jpeg(image, _QUALITY))
        written.append(path)
    progress("overlays", len(frames), len(frames))
    return tuple(written)
