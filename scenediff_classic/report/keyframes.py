"""Key frames side by side: which pairs of views to show, and their pictures."""

from dataclasses import dataclass

from scenediff_classic.masks import area
from scenediff_classic.report.drawing import draw_marks, marks_of
from scenediff_classic.report.embedded import Picture, embed, fit
from scenediff_classic.types import Capture, ChangeResult, Evidence, Frame, Video

_LONG_SIDE = 640
_Key = tuple[Video, int]


@dataclass(frozen=True)
class KeyFrame:
    """A frame with its changed objects painted in."""

    video: Video
    title: str
    picture: Picture


@dataclass(frozen=True)
class KeyPair:
    """A frame of each capture that look at the same part of the scene."""

    before: KeyFrame | None
    after: KeyFrame | None


def choose_pairs(
    result: ChangeResult, evidence: Evidence, limit: int
) -> tuple[tuple[int, int], ...]:
    """Compared view pairs worth showing, in the order of the captures.

    First the pairs that show each object well in each capture (greedily, each adding the most
    that was not seen before), then pairs of frames not shown yet.
    """
    keys = [view.key for view in evidence.geometry.views]
    worth = _worth(result)
    left, chosen = list(dict.fromkeys(evidence.pairs)), []
    shown: dict[tuple[int, Video], float] = {}

    def gain(pair: tuple[int, int]) -> tuple[float, int]:
        more = 0.0
        for key in (keys[pair[0]], keys[pair[1]]):
            for item, share in worth.get(key, {}).items():
                more += max(share - shown.get((item, key[0]), 0.0), 0.0)
        used = {view for done in chosen for view in done}
        return round(more, 2), sum(view not in used for view in pair)

    while left and len(chosen) < limit:
        best = max(left, key=gain)
        if gain(best) <= (0.0, 0):
            break
        left.remove(best)
        chosen.append(best)
        for key in (keys[best[0]], keys[best[1]]):
            for item, share in worth.get(key, {}).items():
                shown[item, key[0]] = max(shown.get((item, key[0]), 0.0), share)
    return tuple(sorted(chosen, key=lambda pair: (keys[pair[0]], keys[pair[1]])))


def _worth(result: ChangeResult) -> dict[_Key, dict[int, float]]:
    """Per frame and object: the object's area there, relative to its largest in that capture."""
    sizes: dict[tuple[int, Video, int], int] = {
        (item.id, view.video, view.frame): area(view.mask)
        for item in result.objects
        for view in item.views
    }
    largest: dict[tuple[int, Video], int] = {}
    for (item, video, _), size in sizes.items():
        largest[item, video] = max(largest.get((item, video), 1), size)
    worth: dict[_Key, dict[int, float]] = {}
    for (item, video, frame), size in sizes.items():
        worth.setdefault((video, frame), {})[item] = size / largest[item, video]
    return worth


def key_pairs(
    result: ChangeResult,
    evidence: Evidence,
    captures: dict[Video, Capture],
    pairs: tuple[tuple[int, int], ...],
) -> tuple[KeyPair, ...]:
    """Pictures of the chosen pairs; of all captures' first frames where no pair was compared."""
    frames = {
        (frame.video, frame.index): frame
        for capture in captures.values()
        for frame in capture.frames
    }
    keys = [view.key for view in evidence.geometry.views]
    chosen = [(frames.get(keys[b]), frames.get(keys[a])) for b, a in pairs]
    if not chosen:
        chosen = [(captures["before"].frames[:1], captures["after"].frames[:1])]
        chosen = [(next(iter(b), None), next(iter(a), None)) for b, a in chosen]
    return tuple(KeyPair(_key_frame(result, b), _key_frame(result, a)) for b, a in chosen)


def frame_title(frame: Frame) -> str:
    """How the page names a frame."""
    time = "" if frame.time_s is None else f" · {frame.time_s:.1f} s"
    return f"frame {frame.index} · {frame.name}{time}"


def _key_frame(result: ChangeResult, frame: Frame | None) -> KeyFrame | None:
    if frame is None:
        return None
    image = fit(frame.image, _LONG_SIDE)
    marks = marks_of(result, frame.video, frame.index, *image.shape[:2])
    names = ", ".join(mark.label for mark in sorted(marks, key=lambda m: m.id))
    alt = f"{frame.video}, frame {frame.index}: " + (names or "no changed object")
    return KeyFrame(frame.video, frame_title(frame), embed(draw_marks(image, marks), alt))
