"""The analytic card scene in the layout of a rendered pair."""

from pathlib import Path

import numpy as np
from PIL import Image

from scenediff_classic import masks
from scenediff_classic.dataset import (
    SAMPLE_STEP,
    AnnotatedMask,
    AnnotatedObject,
    AnnotatedPair,
    Track,
    write_annotations,
)
from scenediff_classic.types import VIDEOS, View
from tests.plane_scene import BOOK, BOOK_ELSEWHERE, CLOCK, VASE, scene

CARDS = {1: ("removed", VASE), 2: ("moved", BOOK), 3: ("added", CLOCK)}
"""Object -> (kind, card); every one stands at a depth of its own."""


def write_cards(folder: Path) -> None:
    """Vase removed, clock added, book moved; three frames of 120 x 90 a capture."""
    views = scene([VASE, BOOK], [BOOK_ELSEWHERE, CLOCK]).views
    seen = {view.key: _instances(view) for view in views}
    for view in views:
        path = folder / view.video / f"{view.index:04d}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(view.image).save(path)
    video = np.array([VIDEOS.index(v.video) for v in views])
    index = np.array([v.index for v in views])
    np.savez(
        folder / "truth_geometry.npz",
        intrinsics=np.stack([v.intrinsics for v in views]),
        cam_from_world=np.stack([v.cam_from_world for v in views]),
        depth=np.stack([v.depth for v in views]),
        video=video,
        index=index,
    )
    np.savez(
        folder / "truth_instances.npz",
        instances=np.stack([seen[v.key] for v in views]),
        video=video,
        index=index,
        id=np.array(list(CARDS)),
        kind=np.array([kind for kind, _ in CARDS.values()]),
    )
    tracks = tuple(
        Track(name, number, tuple(shown))
        for name in VIDEOS
        for number in CARDS
        if (
            shown := [
                AnnotatedMask(SAMPLE_STEP * v.index, masks.encode(seen[v.key] == number))
                for v in views
                if v.video == name and (seen[v.key] == number).any()
            ]
        )
    )
    objects = tuple(
        AnnotatedObject(
            number, f"card {number}", kind != "added", kind != "removed", deformability="rigid"
        )
        for number, (kind, _) in CARDS.items()
    )
    write_annotations(AnnotatedPair("cards", tracks, objects), folder)


def _instances(view: View) -> np.ndarray:
    plane = view.depth - view.cam_from_world[2, 3]
    out = np.zeros(view.shape, np.uint8)
    for number, (_, card) in CARDS.items():
        out[np.abs(plane - card.z) < 1e-3] = number
    return out
