"""Results to write and read in tests: drawn at random, and one written out by hand."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

import scenediff_classic
from scenediff_classic.masks import bbox, encode
from scenediff_classic.types import (
    ChangedObject,
    ChangeResult,
    FrameInfo,
    Match,
    ObjectView,
    PairScore,
    Placement,
    Support,
    TermScores,
    VideoInfo,
)

SCHEMA = json.loads(
    (Path(scenediff_classic.__file__).parent / "changes.schema.json").read_text("utf-8")
)

finite = st.floats(-1e6, 1e6, allow_nan=False)
share = st.floats(0, 1)
positive = st.floats(1e-6, 1e6)
text = st.text(max_size=8)


def optional_vector(values: st.SearchStrategy[float]) -> st.SearchStrategy:
    return st.none() | st.tuples(values, values, values)


Draw = Callable[[st.SearchStrategy], Any]


def drawn_frame(draw: Draw, index: int) -> FrameInfo:
    registered = draw(st.booleans())
    return FrameInfo(
        index,
        draw(text),
        draw(st.none() | st.floats(0, 1e5)),
        draw(st.integers(1, 9)),
        draw(st.integers(1, 9)),
        registered,
        None if registered else draw(text),
        Placement(
            draw(share),
            9,
            draw(st.integers(0, 9)),
            draw(share),
            draw(positive),
            draw(st.none() | share),
        )
        if registered and draw(st.booleans())
        else None,
    )


def drawn_result(draw: Draw) -> ChangeResult:
    """Built in the test, not in a strategy: checked constructors draw random numbers."""
    videos = {
        name: VideoInfo(
            draw(text), tuple(drawn_frame(draw, i) for i in range(draw(st.integers(0, 3))))
        )
        for name in ("before", "after")
    }
    places = [(name, frame) for name, info in videos.items() for frame in info.frames]

    def view() -> ObjectView:
        video, frame = draw(st.sampled_from(places))
        pixels = draw(st.binary(min_size=81, max_size=81))
        mask = np.frombuffer(pixels, np.uint8)[: frame.height * frame.width] > 127
        rle = encode(mask.reshape(frame.height, frame.width))
        return ObjectView(video, frame.index, draw(share), bbox(rle), rle)

    def support() -> Support | None:
        taken = {name: [f.index for f in info.frames] for name, info in videos.items()}
        if not all(taken.values()):
            return None
        sides = ("before", "after"), ("after", "before")
        strongest = tuple(
            PairScore(
                video, draw(st.sampled_from(taken[video])), draw(st.sampled_from(taken[other])),
                draw(finite),
            )
            for video, other in sides[: draw(st.integers(0, 2))]
        )  # fmt: skip
        return Support(9, draw(st.integers(0, 9)), strongest)

    objects = tuple(
        ChangedObject(
            number,
            draw(st.sampled_from(["added", "removed", "moved"])),
            draw(share),
            draw(optional_vector(finite)),
            draw(optional_vector(finite)),
            draw(optional_vector(positive)),
            draw(optional_vector(positive)),
            TermScores(draw(finite), draw(finite), draw(finite)),
            tuple(view() for _ in range(draw(st.integers(0, 2)) if places else 0)),
            support(),
            Match(draw(finite), draw(share), draw(positive), 2.5) if draw(st.booleans()) else None,
        )
        for number in range(draw(st.integers(0, 3)))
    )
    return ChangeResult(
        videos["before"],
        videos["after"],
        objects,
        draw(st.none() | finite),
        draw(positive),
        tuple(draw(st.lists(text, max_size=2))),
        draw(st.none() | st.integers(0, 9)),
    )


def one_object() -> ChangeResult:
    """A 4 x 3 frame each; pixels (1, 1), (1, 2) of the after frame were added."""
    mask = np.zeros((3, 4), bool)
    mask[1, 1:3] = True
    view = ObjectView("after", 0, 0.9, (1.0, 1.0, 2.0, 1.0), encode(mask))
    item = ChangedObject(
        0, "added", 0.9, None, (0.1234567, 2.0, -3.0), None, (0.5, 0.25, 1.0),
        TermScores(0.2, 0.4, 0.1), (view,), Support(4, 3, (PairScore("after", 0, 0, 0.75),)),
        Match(0.5, 0.9, 1.25, 2.5),
    )  # fmt: skip
    placement = Placement(0.5, 80, 20, 0.25, 0.7, 0.875)
    frame = FrameInfo(0, "a\udcff.jpg", None, 4, 3, True, None, placement)
    lost = FrameInfo(0, "küche#0", 1.0000004, 4, 3, False, "too dark")
    return ChangeResult(
        VideoInfo("old.mp4", (lost,)), VideoInfo("new", (frame,)), (item,), 0.31, 2.5, ("dim",), 20
    )


GOLDEN = {
    "schema": 1,
    "videos": {
        "before": {
            "source": "old.mp4",
            "frames": [
                {
                    "index": 0, "name": "küche#0", "time_s": 1.0, "width": 4, "height": 3,
                    "registered": False, "reason": "too dark", "placement": None,
                }
            ],
        },
        "after": {
            "source": "new",
            "frames": [
                {
                    "index": 0, "name": "a\udcff.jpg", "time_s": None, "width": 4, "height": 3,
                    "registered": True, "reason": None,
                    "placement": {
                        "confidence": 0.5, "points": 80, "shared": 20, "cover": 0.25,
                        "error_px": 0.7, "agreement": 0.875,
                    },
                }
            ],
        },
    },
    "objects": [
        {
            "id": 0,
            "kind": "added",
            "confidence": 0.9,
            "centroid_before": None,
            "centroid_after": [0.123457, 2.0, -3.0],
            "extent_before": None,
            "extent_after": [0.5, 0.25, 1.0],
            "scores": {"geometry": 0.2, "feature": 0.4, "region": 0.1},
            "support": {
                "compared": 4, "above": 3,
                "strongest": [{"video": "after", "frame": 0, "other": 0, "score": 0.75}],
            },
            "match": {"similarity": 0.5, "least": 0.9, "size_ratio": 1.25, "most": 2.5},
            "views": [
                {
                    "video": "after",
                    "frame": 0,
                    "confidence": 0.9,
                    "bbox": [1.0, 1.0, 2.0, 1.0],
                    # Column-major runs are 4, 1, 2, 1, 4; from the fourth one on COCO keeps the
                    # difference to the run two before: 4, 1, 2, 1 - 1, 4 - 2.
                    "rle": {"size": [3, 4], "counts": "41202"},
                }
            ],
        }
    ],
    "threshold": 0.31,
    "scale": 2.5,
    "warnings": ["dim"],
    "bridge": 20,
}  # fmt: skip
