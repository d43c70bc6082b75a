"""What can be wrong with annotated masks, and how many there are."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from scenediff_classic import masks
from scenediff_classic.dataset import SAMPLE_STEP, AnnotatedPair, read_annotations
from scenediff_classic.errors import InputError
from scenediff_classic.types import VIDEOS


def mask_problems(truth: Path) -> list[str]:
    """Everything that is wrong with a pair's annotations, a sentence each."""
    try:
        pair = read_annotations(truth)
    except InputError as error:
        return [str(error)]
    found = []
    numbers = Counter(item.object_id for item in pair.objects if item.kind is not None)
    found += [f"{truth}: object number {n} is listed twice." for n, k in numbers.items() if k > 1]
    for video in VIDEOS:
        sizes = {m.mask.size for t in pair.tracks if t.video == video for m in t.masks}
        if len(sizes) > 1:
            shown = ", ".join(f"{w}x{h}" for h, w in sorted(sizes))
            found.append(f"{truth}: masks of the {video} capture differ in size: {shown}.")
    for item in pair.objects:
        name = f"{item.label or 'object'} ({item.object_id})"
        if item.kind is None:
            found.append(f"{truth}: {name} is flagged in neither capture and is not counted.")
        for video in VIDEOS:
            track = pair.track(video, item.object_id) if item.present(video) else None
            sampled = [m for m in track.masks if m.frame % SAMPLE_STEP == 0] if track else []
            if item.present(video) and not sampled:
                found.append(f"{truth}: {name} has no mask in a sampled {video} frame.")
            elif item.present(video) and not any(masks.area(m.mask) for m in sampled):
                found.append(f"{truth}: all {video} masks of {name} are empty.")
    known = {item.object_id for item in pair.objects}
    lost = sorted({t.object_id for t in pair.tracks} - known)
    found += [f"{truth}: object {n} has masks but is not listed." for n in lost]
    return found


@dataclass(frozen=True)
class Statistics:
    """Counts over annotated pairs."""

    pairs: int
    objects: dict[str, int]
    """By change type."""
    frames: int
    """Sampled frames with at least one mask."""
    regions: int
    """Masks in sampled frames."""
    median_area: float
    """Of these, as a share of the picture; 0 if there are none."""


def statistics(pairs: Iterable[AnnotatedPair]) -> Statistics:
    """Count what the annotations hold; objects in neither capture are left out."""
    count, kinds, frames, areas = 0, Counter[str](), 0, []
    for pair in pairs:
        count += 1
        seen = set()
        for item in pair.objects:
            if item.kind is None:
                continue
            kinds[item.kind] += 1
            for video in VIDEOS:
                track = pair.track(video, item.object_id) if item.present(video) else None
                for annotated in track.masks if track else ():
                    if annotated.frame % SAMPLE_STEP == 0:
                        high, wide = annotated.mask.size
                        areas.append(masks.area(annotated.mask) / (high * wide))
                        seen.add((video, annotated.frame))
        frames += len(seen)
    areas.sort()
    return Statistics(
        count, dict(kinds), frames, len(areas), areas[len(areas) // 2] if areas else 0.0
    )
