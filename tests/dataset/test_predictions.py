"""Predictions from both files, and everything that can be wrong with them."""

import contextlib
import copy
import json
import pickle

import numpy as np
import pytest

from scenediff_classic import masks
from scenediff_classic.dataset import (
    Picture,
    PredictedObject,
    PredictedView,
    Prediction,
    find_prediction,
    read_prediction,
)
from scenediff_classic.errors import InputError

MASK = masks.encode(np.eye(6, 8, dtype=bool))
RLE = {"size": [6, 8], "counts": MASK.counts}


def view(video="before", frame=0, confidence=0.5, **more):
    box = [0, 0, 6, 6]
    return {
        "video": video,
        "frame": frame,
        "confidence": confidence,
        "bbox": box,
        "rle": RLE,
        **more,
    }


def changes(*objects) -> dict:
    frame = {"index": 0, "name": "ä.jpg", "width": 8, "height": 6, "time_s": None, "extra": 1}
    videos = {"before": {"source": "a", "frames": [frame]}, "after": {"source": "b", "frames": []}}
    return {"schema": 1, "videos": videos, "objects": list(objects), "threshold": 0.1, "new": {}}


def item(kind="removed", views=(), number=1):
    return {"id": number, "kind": kind, "confidence": 0.7, "views": list(views), "scores": {}}


def read_changes(tmp_path, content) -> Prediction:
    path = tmp_path / "changes.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return read_prediction(path)


def read_masks(tmp_path, content) -> Prediction:
    path = tmp_path / "object_masks.pkl"
    path.write_bytes(pickle.dumps(content))
    return read_prediction(path)


def test_changes_json(tmp_path):
    found = read_changes(
        tmp_path,
        changes(
            item("moved", [view("after", 3, 0.25), view("before", 9, 1)], 4),
            item("added", [], 5),
        ),
    )
    assert found == Prediction(
        (
            PredictedObject(
                4,
                "moved",
                (PredictedView("before", 9, 1.0, MASK), PredictedView("after", 3, 0.25, MASK)),
            ),
            PredictedObject(5, "added", ()),
        ),
        (6, 8),
        (Picture("before", 0, "ä.jpg", 6, 8),),
    )


def test_published_layout(tmp_path):
    frame = {"mask": {"size": [6, 8], "counts": MASK.counts.encode()}, "mask_size": 6}
    found = read_masks(
        tmp_path,
        {
            "H": np.int64(6),
            "W": 8,
            3: {"video_1": {0: {**frame, "cost": np.float32(0.5)}}, "video_2": {}},
            "x": {"video_2": {np.int64(2): {**frame, "cost": 1}}, "label": 1, "confidence": 0.3},
            5: {"video_1": {}},
            6: {"label": 0},
        },
    )
    assert found == Prediction(
        (
            PredictedObject(3, "moved", (PredictedView("before", 0, 0.5, MASK),)),
            PredictedObject("x", "added", (PredictedView("after", 2, 1.0, MASK),)),
            PredictedObject(5, "removed", ()),
        ),
        (6, 8),
    )


@pytest.mark.parametrize("captures", [["video_1"], ["video_2"], ["video_1", "video_2"]])
def test_nesting_of_the_readme_is_recognised(tmp_path, captures):
    by_object = {1: {0: {"mask": RLE, "cost": 0.5}}}
    with pytest.raises(InputError, match=r"video -> object -> frame.*would score this file 0"):
        read_masks(tmp_path, {"H": 6, "W": 8, **dict.fromkeys(captures, by_object)})


def test_no_object_is_no_nesting(tmp_path):
    assert read_masks(tmp_path, {"H": 6, "W": 8}).objects == ()
    assert read_masks(tmp_path, {}) == Prediction(())


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "not valid JSON"),
        ('{"schema": 1, "objects": [', "not valid JSON"),
        ([], "should be a mapping"),
        ({**changes(), "schema": 2}, "another version"),
        ({"schema": 1}, "'objects' is missing"),
        ({**changes(), "videos": []}, "should be a mapping"),
        ({**changes(), "objects": {}}, "should be a list"),
        (changes({}), r"objects\[0\]: 'kind' is missing"),
        (changes(item("changed")), "one of added, removed, moved"),
        (changes(item(["moved"])), "one of added, removed, moved"),
        (changes(item(number="a")), r"objects\[0\]\.id should be a whole number"),
        (changes(item(views=[view("third")])), "one of before, after"),
        (changes(item(views=[view(frame=0.5)])), "whole number"),
        (changes(item(views=[view(frame=10**12)])), "outside 0"),
        (changes(item(views=[view(frame=-1)])), "outside 0"),
        (changes(item(views=[view(confidence="1")])), "finite number"),
        (changes(item(views=[view(confidence=10**400)])), "too large"),
        (changes(item(views=[view(rle={**RLE, "counts": "!"})])), "cannot be decoded"),
        (changes(item("removed", [view("after")])), "'removed' but has a mask in the after"),
        (changes(item("added", [view("before")])), "'added' but has a mask in the before"),
        (changes(item(views=[view(), view()])), "two masks in one frame"),
    ],
)
def test_malformed_changes(tmp_path, content, message):
    with pytest.raises(InputError, match=message) as error:
        read_changes(tmp_path, content)
    assert "changes.json" in str(error.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ([], "should be a mapping"),
        ({1: []}, "object 1 should be a mapping"),
        ({1: {"video_1": []}}, "should be a mapping"),
        ({1: {"video_1": {0: {"mask": RLE}}}}, "'cost' is missing"),
        ({1: {"video_1": {0: {"cost": 1.0}}}}, "'mask' is missing"),
        ({1: {"video_1": {0: {"cost": float("nan"), "mask": RLE}}}}, "finite number"),
        ({1: {"video_1": {"a": {"cost": 1.0, "mask": RLE}}}}, "whole number"),
        ({(1, 2): {"video_1": {}}}, "short text"),
        ({"H": "tall", "W": 8}, "'H' should be a whole number"),
        ({"H": 0, "W": 8}, "outside 1"),
    ],
)
def test_malformed_published_files(tmp_path, content, message):
    with pytest.raises(InputError, match=message) as error:
        read_masks(tmp_path, content)
    assert "object_masks.pkl" in str(error.value)


def test_no_single_damage_causes_anything_but_a_clear_error(tmp_path):
    """Every value of a good file, replaced by each of several wrong ones."""
    good = changes(item("moved", [view(), view("after")]))
    for path in list(_paths(good)):
        for wrong in (None, -1, "x", [], {}, 1.5, True):
            damaged = copy.deepcopy(good)
            node = damaged
            for step in path[:-1]:
                node = node[step]
            node[path[-1]] = wrong
            with contextlib.suppress(InputError):
                read_changes(tmp_path, damaged)


def _paths(node, path=()):
    steps = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in steps:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from _paths(value, (*path, key))


def test_which_file_is_taken(tmp_path):
    assert find_prediction(tmp_path) is None
    assert find_prediction(tmp_path / "absent") is None
    (tmp_path / "object_masks.pkl").touch()
    assert find_prediction(tmp_path) == tmp_path / "object_masks.pkl"
    (tmp_path / "changes.json").touch()
    assert find_prediction(tmp_path) == tmp_path / "changes.json"
