"""Reading ``changes.json``: nothing in the file is trusted."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar, get_args

from scenediff_classic.errors import InputError
from scenediff_classic.masks import verified
from scenediff_classic.result.writing import SCHEMA_VERSION
from scenediff_classic.types import (
    VIDEOS,
    ChangedObject,
    ChangeResult,
    FrameInfo,
    Kind,
    Match,
    ObjectView,
    PairScore,
    Placement,
    Support,
    TermScores,
    Video,
    VideoInfo,
)

_T = TypeVar("_T")
_KINDS: tuple[Kind, ...] = get_args(Kind)
_Sizes = dict[tuple[Video, int], tuple[int, int]]
"""Height and width of every frame, by (video, index)."""


def read_result(path: Path) -> ChangeResult:
    """Read ``changes.json``.

    Raises
    ------
    InputError
        If the file is absent, damaged, of another schema version, or something else altogether;
        the message names the first field that is wrong.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
        return _read_document(_Node(document, ""))
    except OSError as error:
        reason = error.strerror or "it cannot be opened"
        raise InputError(
            f"{path} cannot be read ({reason}): name an existing changes.json."
        ) from error
    except _MalformedError as error:
        raise InputError(f"{path} is not a result this version can read: {error}.") from error
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path} is not valid JSON: the file is damaged or is not a changes.json; "
            "run the detection again."
        ) from error


class _MalformedError(Exception):
    """A field is absent or has the wrong type."""


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


@dataclass(frozen=True)
class _Node:
    """A JSON value that knows where in the document it stands."""

    value: Any
    where: str

    def fail(self, expected: str) -> NoReturn:
        raise _MalformedError(f"{self.where or 'the document'} should be {expected}")

    def __getitem__(self, key: str) -> "_Node":
        if not isinstance(self.value, dict):
            self.fail("an object")
        where = f"{self.where}.{key}" if self.where else key
        if key not in self.value:
            raise _MalformedError(f"{where} is missing")
        return _Node(self.value[key], where)

    def optional(self, key: str) -> "_Node":
        """A field that earlier versions did not write; null if it is absent."""
        present = isinstance(self.value, dict) and key in self.value
        return self[key] if present else _Node(None, f"{self.where}.{key}")

    def items(self) -> list["_Node"]:
        if not isinstance(self.value, list):
            self.fail("a list")
        return [_Node(item, f"{self.where}[{i}]") for i, item in enumerate(self.value)]

    def text(self) -> str:
        return self.value if isinstance(self.value, str) else self.fail("a text")

    def truth(self) -> bool:
        return self.value if isinstance(self.value, bool) else self.fail("true or false")

    def whole(self, least: int = 0) -> int:
        if isinstance(self.value, bool) or not isinstance(self.value, int) or self.value < least:
            self.fail(f"a whole number of at least {least}")
        return self.value

    def number(self) -> float:
        if isinstance(self.value, bool) or not isinstance(self.value, (int, float)):
            self.fail("a number")
        try:
            number = float(self.value)
        except OverflowError:
            number = math.inf
        return number if math.isfinite(number) else self.fail("a finite number")

    def vector(self, length: int) -> tuple[float, ...]:
        if len(self.items()) != length:
            self.fail(f"a list of {length} numbers")
        return tuple(item.number() for item in self.items())

    def one_of(self, choices: tuple[_T, ...]) -> _T:
        for choice in choices:
            if choice == self.value:
                return choice
        return self.fail("one of " + ", ".join(map(str, choices)))

    def or_none(self, read: Callable[["_Node"], _T]) -> _T | None:
        return None if self.value is None else read(self)


def _read_document(root: _Node) -> ChangeResult:
    if root["schema"].whole() != SCHEMA_VERSION:
        root["schema"].fail(f"{SCHEMA_VERSION}, the schema this program reads")
    videos: dict[Video, VideoInfo] = {video: _read_video(root["videos"][video]) for video in VIDEOS}
    sizes: _Sizes = {
        (video, frame.index): (frame.height, frame.width)
        for video, info in videos.items()
        for frame in info.frames
    }
    return ChangeResult(
        before=videos["before"],
        after=videos["after"],
        objects=tuple(_read_object(node, sizes) for node in root["objects"].items()),
        threshold=root["threshold"].or_none(_Node.number),
        scale=root["scale"].number(),
        warnings=tuple(node.text() for node in root["warnings"].items()),
        bridge=root.optional("bridge").or_none(_Node.whole),
    )


def _read_video(node: _Node) -> VideoInfo:
    frames = tuple(
        FrameInfo(
            index=frame["index"].whole(),
            name=frame["name"].text(),
            time_s=frame["time_s"].or_none(_Node.number),
            width=frame["width"].whole(1),
            height=frame["height"].whole(1),
            registered=frame["registered"].truth(),
            reason=frame["reason"].or_none(_Node.text),
            placement=frame.optional("placement").or_none(_read_placement),
        )
        for frame in node["frames"].items()
    )
    return VideoInfo(node["source"].text(), frames)


def _read_placement(node: _Node) -> Placement:
    return Placement(
        confidence=node["confidence"].number(),
        points=node["points"].whole(),
        shared=node["shared"].whole(),
        cover=node["cover"].number(),
        error_px=node["error_px"].number(),
        agreement=node.optional("agreement").or_none(_Node.number),
    )


def _read_object(node: _Node, sizes: _Sizes) -> ChangedObject:
    def point(key: str) -> tuple[float, float, float] | None:
        vector = node[key].or_none(lambda n: n.vector(3))
        return None if vector is None else (vector[0], vector[1], vector[2])

    scores = node["scores"]
    return ChangedObject(
        id=node["id"].whole(),
        kind=node["kind"].one_of(_KINDS),
        confidence=node["confidence"].number(),
        centroid_before=point("centroid_before"),
        centroid_after=point("centroid_after"),
        extent_before=point("extent_before"),
        extent_after=point("extent_after"),
        scores=TermScores(
            scores["geometry"].number(), scores["feature"].number(), scores["region"].number()
        ),
        views=tuple(_read_view(view, sizes) for view in node["views"].items()),
        support=node.optional("support").or_none(lambda n: _read_support(n, sizes)),
        match=node.optional("match").or_none(_read_match),
    )


def _read_support(node: _Node, sizes: _Sizes) -> Support:
    def pair(item: _Node) -> PairScore:
        video: Video = item["video"].one_of(VIDEOS)
        frame, other = item["frame"].whole(), item["other"].whole()
        if (video, frame) not in sizes:
            item["frame"].fail(f"the index of a frame of {video}")
        opposite: Video = "after" if video == "before" else "before"
        if (opposite, other) not in sizes:
            item["other"].fail(f"the index of a frame of {opposite}")
        return PairScore(video, frame, other, item["score"].number())

    return Support(
        compared=node["compared"].whole(),
        above=node["above"].whole(),
        strongest=tuple(pair(item) for item in node["strongest"].items()),
    )


def _read_match(node: _Node) -> Match:
    return Match(
        similarity=node["similarity"].number(),
        least=node["least"].number(),
        size_ratio=node["size_ratio"].number(),
        most=node["most"].number(),
    )


def _read_view(node: _Node, sizes: _Sizes) -> ObjectView:
    video: Video = node["video"].one_of(VIDEOS)
    frame = node["frame"].whole()
    if (video, frame) not in sizes:
        node["frame"].fail(f"the index of a frame of {video}")
    x, y, width, height = node["bbox"].vector(4)
    rle = node["rle"]
    try:
        mask = verified(rle["size"].value, rle["counts"].value, rle.where)
    except InputError as error:
        raise _MalformedError(str(error).rstrip(".")) from error
    if mask.size != sizes[video, frame]:
        rle["size"].fail("the [height, width] of its frame")
    return ObjectView(video, frame, node["confidence"].number(), (x, y, width, height), mask)
