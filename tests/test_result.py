"""``changes.json`` and ``run.json``: contract, round trip, refusals."""

import copy
import dataclasses
import json
import math
import re
from collections.abc import Callable
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import scenediff_classic
from scenediff_classic.errors import InputError
from scenediff_classic.masks import bbox, encode
from scenediff_classic.result import RunInfo, json_ready, read_result, write_result, write_run
from scenediff_classic.types import (
    ChangedObject,
    ChangeResult,
    FrameInfo,
    ObjectView,
    Placement,
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
        Placement(draw(share), 9, draw(st.integers(0, 9)), draw(share), draw(positive))
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
        TermScores(0.2, 0.4, 0.1), (view,),
    )  # fmt: skip
    placement = Placement(0.5, 80, 20, 0.25, 0.7)
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
                        "error_px": 0.7,
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


def test_the_contract_field_by_field(tmp_path: Path) -> None:
    """Written by hand from the contract; order of the keys included."""
    write_result(one_object(), tmp_path / "changes.json")
    written = json.loads((tmp_path / "changes.json").read_text("utf-8"))
    assert json.dumps(written) == json.dumps(GOLDEN)


def test_the_schema_is_valid_and_accepts_the_golden_file() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.validate(GOLDEN, SCHEMA)


def test_files_of_earlier_versions_are_read(tmp_path: Path) -> None:
    """They say nothing of how firmly frames are placed."""
    old = copy.deepcopy(GOLDEN)
    del old["bridge"]
    for video in old["videos"].values():
        for frame in video["frames"]:
            del frame["placement"]
    jsonschema.validate(old, SCHEMA)
    (tmp_path / "changes.json").write_text(json.dumps(old), "utf-8")
    result = read_result(tmp_path / "changes.json")
    assert result.bridge is None
    assert result.after.frames[0].placement is None


def test_the_documentation_names_every_field() -> None:
    words = (Path(__file__).parents[1] / "docs" / "output.md").read_text("utf-8")
    fields = {path[-1] for path in paths_of(SCHEMA) if path[-2:-1] == ("properties",)}
    fields |= {field.name for field in dataclasses.fields(RunInfo)}
    assert len(fields) > 30
    missing = {name for name in fields if not re.search(rf"\b{name}\b", words)}
    assert missing == set()


def paths_of(value: object, where: tuple = ()) -> list[tuple]:
    """Every key path in a JSON document."""
    if isinstance(value, dict):
        below = [paths_of(item, (*where, key)) for key, item in value.items()]
    elif isinstance(value, list):
        below = [paths_of(item, (*where, i)) for i, item in enumerate(value)]
    else:
        below = []
    return [where, *(path for paths in below for path in paths)]


def without(path: tuple) -> dict:
    document = copy.deepcopy(GOLDEN)
    parent = document
    for key in path[:-1]:
        parent = parent[key]
    del parent[path[-1]]
    return document


def with_value(path: tuple, value: object) -> dict:
    document = copy.deepcopy(GOLDEN)
    parent = document
    for key in path[:-1]:
        parent = parent[key]
    parent[path[-1]] = value
    return document


FIELDS = [path for path in paths_of(GOLDEN) if path and isinstance(path[-1], str)]


@pytest.mark.parametrize("path", FIELDS, ids=lambda p: ".".join(map(str, p)))
def test_every_field_is_required_and_typed(path: tuple, tmp_path: Path) -> None:
    file = tmp_path / "changes.json"
    documents = [with_value(path, {"foreign": True})]
    if path[-1] not in ("bridge", "placement"):  # see test_files_of_earlier_versions_are_read
        documents.append(without(path))
    for document in documents:
        assert not jsonschema.Draft202012Validator(SCHEMA).is_valid(document)
        file.write_text(json.dumps(document), "utf-8")
        with pytest.raises(InputError) as caught:
            read_result(file)
        assert str(file) in str(caught.value)
        assert path[-1] in str(caught.value)


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("schema",), 2, "schema should be 1"),
        (("threshold",), "high", "threshold should be a number"),
        (("threshold",), True, "threshold should be a number"),
        (("objects", 0, "kind"), "stolen", "added, removed, moved"),
        (("objects", 0, "id"), -1, "whole number"),
        (("objects", 0, "centroid_after"), [1, 2], "list of 3"),
        (("objects", 0, "views", 0, "frame"), 7, "frame of after"),
        (("objects", 0, "views", 0, "rle", "size"), [3, 5], "do not fill"),
        (("objects", 0, "views", 0, "rle", "size"), [4, 3], "size"),
        (("objects", 0, "views", 0, "rle", "counts"), "4120", "rle"),
        (("videos", "after", "frames", 0, "width"), 0, "at least 1"),
        (("scale",), 10**400, "finite"),
    ],
)
def test_wrong_values_are_named(path: tuple, value: object, said: str, tmp_path: Path) -> None:
    file = tmp_path / "changes.json"
    file.write_text(json.dumps(with_value(path, value)), "utf-8")
    with pytest.raises(InputError, match=said):
        read_result(file)


@pytest.mark.parametrize(
    "content",
    [b"", b"hello", b"[]", b"null", b"{", b"\xff\xfe", b"[" * 100_000, b'{"schema": NaN}',
     b'{"schema": ' + b"9" * 5000 + b"}"],
    ids=["empty", "text", "list", "null", "cut", "binary", "deep", "nan", "huge"],
)  # fmt: skip
def test_foreign_files_are_refused(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "changes.json"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"changes\.json"):
        read_result(file)


def test_a_file_cut_anywhere_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "changes.json"
    write_result(one_object(), file)
    content = file.read_bytes().rstrip()
    for length in range(0, len(content), 7):
        file.write_bytes(content[:length])
        with pytest.raises(InputError):
            read_result(file)


def test_an_absent_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            read_result(path)


@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_round_trip(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory) -> None:
    result = drawn_result(data.draw)
    folder = tmp_path_factory.mktemp("trip")
    write_result(result, folder / "first.json")
    document = json.loads((folder / "first.json").read_text("utf-8"))
    jsonschema.validate(document, SCHEMA)
    again = read_result(folder / "first.json")
    write_result(again, folder / "second.json")
    assert (folder / "second.json").read_bytes() == (folder / "first.json").read_bytes()
    assert read_result(folder / "second.json") == again
    assert_close(again, result)


def assert_close(ours: ChangeResult, theirs: ChangeResult) -> None:
    """Equal but for the rounding to six digits."""
    assert math.isclose(ours.scale, theirs.scale, rel_tol=1e-5)
    assert (ours.threshold is None) == (theirs.threshold is None)
    assert ours.warnings == theirs.warnings
    for video in ("before", "after"):
        mine, other = getattr(ours, video), getattr(theirs, video)
        assert mine.source == other.source
        for one, two in zip(mine.frames, other.frames, strict=True):
            bare = {"time_s": None, "placement": None}
            assert replace(one, **bare) == replace(two, **bare)
            assert (one.placement is None) == (two.placement is None)
            if one.placement and two.placement:
                assert astuple(one.placement) == pytest.approx(astuple(two.placement), rel=1e-5)
    assert len(ours.objects) == len(theirs.objects)
    for mine, other in zip(ours.objects, theirs.objects, strict=True):
        assert (mine.id, mine.kind) == (other.id, other.kind)
        assert mine.confidence == pytest.approx(other.confidence, rel=1e-5)
        for name in ("centroid_before", "centroid_after", "extent_before", "extent_after"):
            there, here = getattr(other, name), getattr(mine, name)
            assert here == (None if there is None else pytest.approx(there, rel=1e-5))
        assert [v.mask for v in mine.views] == [v.mask for v in other.views]
        assert [v.bbox for v in mine.views] == [v.bbox for v in other.views]


def test_a_number_that_is_none_is_never_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_result(replace(one_object(), scale=math.nan), tmp_path / "changes.json")
    assert list(tmp_path.iterdir()) == []


@dataclass(frozen=True)
class Inner:
    path: Path
    sizes: tuple[int, ...]


@dataclass(frozen=True)
class Outer:
    inner: Inner
    ratio: float
    rest: float = math.inf


def test_configurations_become_json() -> None:
    config = Outer(Inner(Path("a") / "b", (1, 2)), np.float64(0.5))
    assert json_ready(config) == {
        "type": "Outer",
        "inner": {"type": "Inner", "path": str(Path("a") / "b"), "sizes": [1, 2]},
        "ratio": 0.5,
        "rest": "inf",
    }


def test_run_json(tmp_path: Path) -> None:
    info = RunInfo(
        command=("scenediff-classic", "detect"),
        config={"seed": 3},
        versions={"numpy": "2"},
        seed=3,
        stage_seconds={"geometry": 1.5, "scores": 0.25},
        peak_memory_bytes=1024,
        fingerprint={"before": "abc"},
    )
    write_run(info, tmp_path / "run.json")
    assert json.loads((tmp_path / "run.json").read_text("utf-8")) == {
        "schema": 1,
        "command": ["scenediff-classic", "detect"],
        "config": {"seed": 3},
        "versions": {"numpy": "2"},
        "seed": 3,
        "stage_seconds": {"geometry": 1.5, "scores": 0.25},
        "peak_memory_bytes": 1024,
        "git_commit": None,
        "fingerprint": {"before": "abc"},
    }
