"""The truth of a pair, through both of its files, and damaged ones."""

import json
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenediff_classic import masks
from scenediff_classic.dataset import (
    AnnotatedMask,
    AnnotatedObject,
    AnnotatedPair,
    Track,
    read_annotations,
    write_annotations,
)
from scenediff_classic.errors import InputError, OutputError


def square(corner: int):
    mask = np.zeros((6, 8), bool)
    mask[corner : corner + 2, corner : corner + 3] = True
    return masks.encode(mask)


PAIR = AnnotatedPair(
    scene_type="Küche",
    tracks=(
        Track("before", 7, (AnnotatedMask(30, square(1)), AnnotatedMask(0, square(0)))),
        Track("before", 2, ()),
        Track("after", 7, (AnnotatedMask(15, square(2)),)),
    ),
    objects=(
        AnnotatedObject(7, "mug_1", True, True, "rigid", 30, 15, "moved", None),
        AnnotatedObject(2, "towel_1", True, False, "deformable"),
        AnnotatedObject(3, "ghost_1", False, False),
    ),
)


@pytest.mark.parametrize("name", ["segments.json", "segments.pkl"])
def test_round_trip_keeps_everything_in_order(tmp_path, name):
    write_annotations(PAIR, tmp_path)
    assert read_annotations(tmp_path / name) == PAIR


def test_folder_prefers_json(tmp_path):
    write_annotations(PAIR, tmp_path)
    (tmp_path / "segments.pkl").write_bytes(b"broken")
    assert read_annotations(tmp_path) == PAIR
    assert sorted(p.name for p in tmp_path.iterdir()) == ["segments.json", "segments.pkl"]


@given(st.booleans(), st.booleans())
def test_flags_decide_the_change_type(before, after):
    kinds = {(1, 1): "moved", (1, 0): "removed", (0, 1): "added", (0, 0): None}
    item = AnnotatedObject(0, "x", before, after)
    assert item.kind == kinds[before, after]
    assert (item.present("before"), item.present("after")) == (before, after)


def test_track_lookup():
    assert PAIR.track("after", 7) == PAIR.tracks[2]
    assert PAIR.track("after", 2) is None


def test_published_pickle_layout(tmp_path):
    """The keys and types that the benchmark's own tools use."""
    write_annotations(PAIR, tmp_path)
    content = pickle.loads((tmp_path / "segments.pkl").read_bytes())
    assert set(content) == {"scene_type", "video1_objects", "video2_objects", "objects", "comments"}
    assert list(content["video1_objects"]) == [7, 2]
    assert list(content["video1_objects"][7]) == ["30", "0"]
    assert content["objects"][1] == {
        "label": "towel_1",
        "in_video1": True,
        "in_video2": False,
        "video1_frame_idx": -1,
        "video2_frame_idx": -1,
        "video1_status": None,
        "video2_status": None,
        "original_obj_idx": 2,
        "deformability": "deformable",
    }


def test_pickle_with_numpy_values_and_bytes(tmp_path):
    rle = square(1)
    record = {"size": np.array(rle.size), "counts": rle.counts.encode()}
    item = {"label": "mug_1", "in_video1": np.bool_(True), "original_obj_idx": np.int64(4)}
    content = {"scene_type": None, "video2_objects": {}, "objects": [item]}
    content["video1_objects"] = {np.int64(4): {"0": record}}
    (tmp_path / "segments.pkl").write_bytes(pickle.dumps(content))
    pair = read_annotations(tmp_path)
    assert pair.tracks == (Track("before", 4, (AnnotatedMask(0, rle),)),)
    assert pair.objects[0].kind == "removed"


def broken(**changes) -> str:
    content = {"schema": 1, "scene_type": "", "video1_objects": {}, "video2_objects": {}}
    return json.dumps({**content, "objects": [], **changes})


GOOD = {"size": [6, 8], "counts": masks.encode(np.zeros((6, 8), bool)).counts}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not valid JSON"),
        ("[" * 100_000, "not valid JSON"),
        ('{"schema": NaN}', "not valid JSON"),
        ("[]", "should be a mapping"),
        (broken(schema=2), "another version"),
        ('{"schema": 1}', "'video1_objects' is missing"),
        (broken(objects={}), "should be a list"),
        (broken(objects=[3]), r"objects\[0\] should be a mapping"),
        (broken(objects=[{}]), "'original_obj_idx' is missing"),
        (broken(objects=[{"original_obj_idx": "--3"}]), "should be a whole number"),
        (broken(objects=[{"original_obj_idx": 1, "in_video1": "yes"}]), "true or false"),
        (broken(objects=[{"original_obj_idx": 1, "label": []}]), "short text"),
        (broken(video1_objects=[]), "should be a mapping"),
        (broken(video1_objects={"a": {}}), "should be a whole number"),
        (broken(video1_objects={"1": {}, "01": {}}), "has an object twice"),
        (broken(video1_objects={"1": {"0": GOOD, "00": GOOD}}), "has a frame twice"),
        (broken(video1_objects={"1": {"-30": GOOD}}), "outside 0"),
        (broken(video1_objects={"1": {"0": {"size": [6, 8]}}}), "'counts' is missing"),
        (broken(video1_objects={"1": {"0": {**GOOD, "size": [9, 9]}}}), "do not fill"),
        (broken(video1_objects={"1": {"0": {**GOOD, "size": [10**9, 1]}}}), "not plausible"),
    ],
)
def test_malformed_files_are_refused_clearly(tmp_path, text, message):
    (tmp_path / "segments.json").write_text(text)
    with pytest.raises(InputError, match=message) as error:
        read_annotations(tmp_path)
    assert str(tmp_path / "segments.json") in str(error.value)


def test_missing_file(tmp_path):
    with pytest.raises(InputError, match=r"segments\.json cannot be read \(No such file"):
        read_annotations(tmp_path)


def test_unwritable_folder(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"):
        write_annotations(PAIR, tmp_path / "file")
