"""``changes.json``: contract, round trip, refusals."""

import copy
import dataclasses
import json
import math
import re
from collections.abc import Iterator
from dataclasses import astuple, replace
from pathlib import Path

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenediff_classic.errors import InputError
from scenediff_classic.result import RunInfo, read_result, write_result
from scenediff_classic.types import ChangeResult, Match, Support
from tests.result.documents import GOLDEN, SCHEMA, drawn_result, one_object


def test_the_contract_field_by_field(tmp_path: Path) -> None:
    """Written by hand from the contract; order of the keys included."""
    write_result(one_object(), tmp_path / "changes.json")
    written = json.loads((tmp_path / "changes.json").read_text("utf-8"))
    assert json.dumps(written) == json.dumps(GOLDEN)


def test_the_schema_is_valid_and_accepts_the_golden_file() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.validate(GOLDEN, SCHEMA)


def test_files_of_earlier_versions_are_read(tmp_path: Path) -> None:
    """They say nothing of how firmly frames are placed, nor why an object was reported."""
    old = copy.deepcopy(GOLDEN)
    del old["bridge"], old["objects"][0]["support"], old["objects"][0]["match"]
    for video in old["videos"].values():
        for frame in video["frames"]:
            del frame["placement"]
    jsonschema.validate(old, SCHEMA)
    (tmp_path / "changes.json").write_text(json.dumps(old), "utf-8")
    result = read_result(tmp_path / "changes.json")
    assert result.bridge is None
    assert result.after.frames[0].placement is None
    assert result.objects[0].support is result.objects[0].match is None

    old = copy.deepcopy(GOLDEN)
    del old["videos"]["after"]["frames"][0]["placement"]["agreement"]
    jsonschema.validate(old, SCHEMA)
    (tmp_path / "changes.json").write_text(json.dumps(old), "utf-8")
    placement = read_result(tmp_path / "changes.json").after.frames[0].placement
    assert placement is not None
    assert placement.agreement is None


def test_the_documentation_names_every_field() -> None:
    words = (Path(__file__).parents[2] / "docs" / "output.md").read_text("utf-8")
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


LATER_FIELDS = ("bridge", "placement", "agreement", "support", "match")
FIELDS = [path for path in paths_of(GOLDEN) if path and isinstance(path[-1], str)]


@pytest.mark.parametrize("path", FIELDS, ids=lambda p: ".".join(map(str, p)))
def test_every_field_is_required_and_typed(path: tuple, tmp_path: Path) -> None:
    file = tmp_path / "changes.json"
    documents = [with_value(path, {"foreign": True})]
    if path[-1] not in LATER_FIELDS:  # see test_files_of_earlier_versions_are_read
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
        (("objects", 0, "support", "strongest", 0, "frame"), 1, "frame of after"),
        (("objects", 0, "support", "strongest", 0, "other"), 1, "frame of before"),
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
                told = [p.agreement is not None for p in (one.placement, two.placement)]
                assert told[0] == told[1]
                numbers = [
                    astuple(p if told[0] else replace(p, agreement=0.0))
                    for p in (one.placement, two.placement)
                ]
                assert numbers[0] == pytest.approx(numbers[1], rel=1e-5)
    assert len(ours.objects) == len(theirs.objects)
    for mine, other in zip(ours.objects, theirs.objects, strict=True):
        assert (mine.id, mine.kind) == (other.id, other.kind)
        assert mine.confidence == pytest.approx(other.confidence, rel=1e-5)
        for name in ("centroid_before", "centroid_after", "extent_before", "extent_after"):
            there, here = getattr(other, name), getattr(mine, name)
            assert here == (None if there is None else pytest.approx(there, rel=1e-5))
        assert [v.mask for v in mine.views] == [v.mask for v in other.views]
        assert [v.bbox for v in mine.views] == [v.bbox for v in other.views]
        for one, two in ((mine.support, other.support), (mine.match, other.match)):
            numbers = [tuple(leaves(x)) if x else () for x in (one, two)]
            assert numbers[0] == pytest.approx(numbers[1], rel=1e-5)


def leaves(value: Support | Match) -> Iterator[float]:
    """All numbers of a small record."""
    for item in astuple(value):
        if isinstance(item, tuple):
            for pair in item:
                yield from (hash(x) if isinstance(x, str) else x for x in pair)
        else:
            yield item


def test_a_number_that_is_none_is_never_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_result(replace(one_object(), scale=math.nan), tmp_path / "changes.json")
    assert list(tmp_path.iterdir()) == []
