"""The choices of strict mode where the paper's text leaves one."""

from collections.abc import Callable

from scenediff_classic.dataset import SAMPLE_STEP, AnnotatedPair, Prediction
from scenediff_classic.evaluation.official import scaled_to_long_side
from scenediff_classic.types import Kind, Video


def strict_grid(
    pair: AnnotatedPair, prediction: Prediction
) -> Callable[[Video, int], tuple[int, int]]:
    """A grid per frame: the frame's own aspect ratio, the long side as in the official mode.

    The truth's masks tell a frame's size; the prediction's do where the truth has none.
    """
    sizes: dict[tuple[Video, int], tuple[int, int]] = {}
    for track in pair.tracks:
        for annotated in track.masks:
            sizes.setdefault((track.video, annotated.frame // SAMPLE_STEP), annotated.mask.size)
    for item in prediction.objects:
        for view in item.views:
            sizes.setdefault((view.video, view.frame), view.mask.size)
    grids = {frame: scaled_to_long_side(*size) for frame, size in sizes.items()}
    return lambda video, frame: grids[video, frame]


def same_kind(predicted: Kind, true: Kind) -> bool:
    """Change types agree if they are the same of the three."""
    return predicted == true
