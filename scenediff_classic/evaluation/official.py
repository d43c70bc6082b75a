"""What the published evaluator does beyond the paper's text, repeated for parity."""

from collections.abc import Callable

from scenediff_classic.dataset import AnnotatedPair, Prediction, Track
from scenediff_classic.types import Kind, Video

LONG_SIDE = 1024
"""Longest side of the grid on which masks are compared, in pixels."""
DEFAULT_SIZE = (1024, 576)
"""(height, width) assumed for a prediction that states none."""


def scaled_to_long_side(first: int, second: int) -> tuple[int, int]:
    """Both sides scaled so that the longer one is `LONG_SIDE`; at least one pixel each."""
    scale = float(LONG_SIDE) / float(max(first, second))
    return max(1, round(first * scale)), max(1, round(second * scale))


def official_grid(
    pair: AnnotatedPair, prediction: Prediction
) -> Callable[[Video, int], tuple[int, int]]:
    """One grid for the whole pair.

    The published evaluator reads a mask's [height, width] as (width, height), so the grid has
    the truth's sides exchanged, and masks are stretched onto it.
    """
    sizes = _candidate_sizes(pair)
    if sizes:
        width, height = scaled_to_long_side(*max(sizes, key=lambda size: size[0] * size[1]))
    else:
        height, width = scaled_to_long_side(*(prediction.size or DEFAULT_SIZE))
    return lambda video, frame: (height, width)


def _candidate_sizes(pair: AnnotatedPair) -> list[tuple[int, int]]:
    """Size of the before capture's first mask, and of the after capture's.

    Once the before capture gave one, only the first object of the after capture is asked.
    """
    before = [track for track in pair.tracks if track.video == "before"]
    after = [track for track in pair.tracks if track.video == "after"]
    sizes = _first_size(before)
    return sizes + _first_size(after[:1] if sizes else after)


def _first_size(tracks: list[Track]) -> list[tuple[int, int]]:
    return [track.masks[0].mask.size for track in tracks if track.masks][:1]


def same_motion(predicted: Kind, true: Kind) -> bool:
    """Change types agree if both are moved or neither is: added and removed are one class."""
    return (predicted == "moved") == (true == "moved")
