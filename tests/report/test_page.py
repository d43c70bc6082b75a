"""The page: whole, self-contained, accessible, safe."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from scenediff_classic.report import write_report
from scenediff_classic.report.page import verdict
from scenediff_classic.types import Capture, Comparison, Evidence, Geometry, SparsePoints
from tests.report.example import Example, example

VOID = {"meta", "link", "img", "br", "input"}


class Reader(HTMLParser):
    """Collects what the checks need, and fails on tags that do not match."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict]] = []
        self.text: list[str] = []

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag) -> None:
        assert self.open
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        if self.open and self.open[-1] not in ("script", "style"):
            self.text.append(data)

    def all(self, tag: str) -> list[dict]:
        return [attributes for name, attributes in self.tags if name == tag]

    def words(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.text))


def page_of(made: Example, folder: Path) -> tuple[str, Reader]:
    path = folder / "report.html"
    write_report(made.result, made.evidence, made.before, made.after, made.run, path)
    html = path.read_text("utf-8")
    reader = Reader()
    reader.feed(html)
    reader.close()
    assert reader.open == []
    return html, reader


@pytest.fixture(scope="module")
def made() -> Example:
    return example()


def test_the_page_tells_the_result(made: Example, tmp_path: Path) -> None:
    _, reader = page_of(made, tmp_path)
    words = reader.words()
    assert "3 objects changed: 1 added, 1 removed, 1 moved" in words
    for text in (
        "0 removed",
        "1 added",
        "2 moved",
        "91 %",
        "0.35 \N{MULTIPLICATION SIGN} 0.55",
        "3 of 4",
    ):
        assert text in words
    for text in ("1 of 4 frames before could not be registered.", "too few matches", "1.2 GB"):
        assert text in words
    for text in ("1 min 35 s", "SfmGeometry", "numpy 2.4.0", "living room/before.mp4"):
        assert text in words


def test_the_page_shows_how_firmly_frames_are_placed(made: Example, tmp_path: Path) -> None:
    html, reader = page_of(made, tmp_path)
    words = reader.words()
    for text in ("How firmly the frames are placed", "points seen by both 1234", "0.19 (low)"):
        assert text in words
    assert html.count('class="low"') == 2
    bare = replace(made, result=replace(made.result, bridge=None))
    for video in ("before", "after"):
        info = getattr(bare.result, video)
        frames = tuple(replace(frame, placement=None) for frame in info.frames)
        bare = replace(bare, result=replace(bare.result, **{video: replace(info, frames=frames)}))
    words = page_of(bare, tmp_path)[1].words()
    assert "How firmly" not in words
    assert "points seen by both" not in words


def test_rows_come_by_confidence(made: Example, tmp_path: Path) -> None:
    objects = tuple(replace(o, confidence=c) for o, c in zip(made.result.objects, (0.1, 0.5, 0.9)))  # noqa: B905
    changed = replace(made, result=replace(made.result, objects=objects))
    words = page_of(changed, tmp_path)[1].words()
    assert words.index("90 %") < words.index("50 %") < words.index("10 %")


def test_nothing_is_loaded_from_elsewhere(made: Example, tmp_path: Path) -> None:
    html, reader = page_of(made, tmp_path)
    for _, attributes in reader.tags:
        for name in ("src", "href", "srcset", "action", "poster"):
            assert attributes.get(name, "data:").startswith("data:")
    assert not re.search(r"https?://", html)
    assert "url(" not in html
    assert "@import" not in html
    assert not re.search(r"\b(fetch|XMLHttpRequest|WebSocket|importScripts|eval)\b", html)


def test_pictures_are_described_and_sized(made: Example, tmp_path: Path) -> None:
    _, reader = page_of(made, tmp_path)
    images = reader.all("img")
    assert len(images) >= 6 + 6 + 5 * 3
    for image in images:
        assert image["alt"].strip()
        assert image["src"].startswith("data:image/jpeg;base64,")
        assert int(image["width"]) > 0
        assert int(image["height"]) > 0


def test_the_structure_helps_a_screen_reader(made: Example, tmp_path: Path) -> None:
    _, reader = page_of(made, tmp_path)
    assert reader.all("html")[0]["lang"] == "en"
    assert len(reader.all("h1")) == 1
    ids = [a["id"] for _, a in reader.tags if "id" in a]
    assert len(ids) == len(set(ids))
    for section in reader.all("section"):
        assert section["aria-labelledby"] in ids
    assert all("scope" in header for header in reader.all("th"))
    (canvas,) = reader.all("canvas")
    assert canvas["aria-label"]
    assert canvas["tabindex"] == "0"


def test_no_change(tmp_path: Path) -> None:
    html, reader = page_of(example(changed=False), tmp_path)
    words = reader.words()
    assert "No change found" in words
    assert "do not stand out of the noise" in words
    assert 'class="objects"' not in html


def test_hostile_names_are_only_text(made: Example, tmp_path: Path) -> None:
    nasty = "<script>alert(1)</script>\udcff{{ 7 * 7 }}"

    def renamed(capture: Capture) -> Capture:
        return replace(capture, frames=tuple(replace(f, name=nasty) for f in capture.frames))

    views = tuple(replace(v, name=nasty) for v in made.evidence.geometry.views)
    bad = replace(
        made,
        before=renamed(made.before),
        after=renamed(made.after),
        evidence=replace(made.evidence, geometry=replace(made.evidence.geometry, views=views)),
        result=replace(made.result, warnings=(nasty,)),
        run=replace(made.run, command=(nasty,), config={nasty: nasty}),
    )
    html, reader = page_of(bad, tmp_path)
    assert len(reader.all("script")) == 2
    assert "<script>alert" not in html
    assert "{{ 7 * 7 }}" in reader.words()


def test_one_photo_each(tmp_path: Path) -> None:
    _, reader = page_of(example(count=1), tmp_path)
    assert "1 of 2" in reader.words()


def test_no_evidence_at_all(made: Example, tmp_path: Path) -> None:
    """A detector that works without cameras has a page too."""
    bare = replace(
        made, evidence=Evidence(Geometry((), SparsePoints.none()), (), ()),
        run=replace(made.run, stage_seconds={}, peak_memory_bytes=None),
    )  # fmt: skip
    html, reader = page_of(bare, tmp_path)
    assert "3 objects changed" in reader.words()
    assert "Score maps" not in html
    assert "Captured and rendered" not in html


def test_captured_and_rendered_pictures(made: Example, tmp_path: Path) -> None:
    comparisons = tuple(
        Comparison(k, v.image, v.image, v.depth, np.isfinite(v.depth))
        for k, v in enumerate(made.evidence.geometry.views)
    )
    more = replace(made, evidence=replace(made.evidence, comparisons=comparisons))
    _, plain = page_of(made, tmp_path)
    _, reader = page_of(more, tmp_path)
    assert "captured rendered difference found" in reader.words()
    strips = [image for image in reader.all("img") if image["alt"].endswith(", rendered")]
    assert len(strips) == len({image["alt"] for image in strips}) == 6
    assert len(reader.all("img")) == len(plain.all("img")) + 4 * 6


def test_the_same_input_gives_the_same_page(made: Example, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    assert page_of(made, tmp_path / "a")[0] == page_of(made, tmp_path / "b")[0]


@pytest.mark.parametrize(
    ("kinds", "doubtful", "said"),
    [
        ((), 0, "No change found"),
        (("added",), 0, "1 object changed: 1 added"),
        (("moved", "added", "added"), 0, "3 objects changed: 2 added, 1 moved"),
        (("added",), 2, "1 object changed: 1 added (2 more doubtful)"),
        ((), 1, "1 doubtful change, no sure one"),
        ((), 2, "2 doubtful changes, no sure one"),
    ],
)
def test_verdict(made: Example, kinds: tuple, doubtful: int, said: str) -> None:
    sure, unsure = (replace(made.result.objects[0], confidence=c) for c in (0.2, 0.19))
    objects = tuple(replace(sure, kind=kind) for kind in kinds) + (unsure,) * doubtful
    assert verdict(replace(made.result, objects=objects)) == said


def test_doubtful_objects_are_marked(made: Example, tmp_path: Path) -> None:
    first, *others = made.result.objects
    doubtful = replace(first, confidence=0.1)
    mixed = replace(made, result=replace(made.result, objects=(doubtful, *others)))
    assert all(not item.doubtful for item in others)
    assert page_of(mixed, tmp_path)[1].words().count("doubtful") == 3
    assert "doubtful" not in page_of(made, tmp_path)[1].words()


@pytest.mark.slow
def test_the_page_stays_small_with_the_worst_pictures(tmp_path: Path) -> None:
    """Pure noise does not compress; many objects, many frames."""
    big = example(640, 480, 9)
    rng = np.random.default_rng(0)

    def noisy(image: np.ndarray) -> np.ndarray:
        return rng.integers(0, 256, image.shape, np.uint8)

    def noisy_capture(capture: Capture) -> Capture:
        frames = tuple(replace(f, image=noisy(f.image)) for f in capture.frames)
        return replace(capture, frames=frames)

    views = tuple(replace(v, image=noisy(v.image)) for v in big.evidence.geometry.views)
    objects = tuple(
        replace(item, id=3 * i + j) for i in range(20) for j, item in enumerate(big.result.objects)
    )
    worst = replace(
        big,
        before=noisy_capture(big.before),
        after=noisy_capture(big.after),
        evidence=replace(big.evidence, geometry=replace(big.evidence.geometry, views=views)),
        result=replace(big.result, objects=objects),
    )
    html, _ = page_of(worst, tmp_path)
    assert len(html) < 15_000_000
