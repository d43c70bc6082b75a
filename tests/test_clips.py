"""Videos: frames by presentation time, orientation, damage."""

import itertools
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenediff_classic.clips import Sampling, nearest_in_time, read_clip
from scenediff_classic.errors import InputError
from scenediff_classic.pictures import Picture
from tests.films import number_in, write_film, write_sound

ONE = 1 << 16  # the display matrix holds 16.16 fixed-point numbers


def read(
    path: Path,
    fps: float = 1.0,
    start_s: float = 0.0,
    end_s: float | None = None,
    warn: Callable[[str], None] = print,
) -> list[Picture]:
    return list(
        read_clip(path, Sampling(fps, start_s, end_s), 1000, warn, lambda done, total: None)
    )


def numbers(pictures: list[Picture]) -> list[int]:
    return [number_in(p.image) for p in pictures]


def times_or_refusal(path: Path, warn: Callable[[str], None] = print) -> list[float]:
    """Times of the frames; none if the file was refused with a sentence that names it."""
    try:
        return [p.time_s or 0.0 for p in read(path, warn=warn)]
    except InputError as error:
        refusal = str(error)
    assert str(path) in refusal
    return []


@pytest.mark.parametrize("name", ["a.mp4", "a.mov", "a.avi", "a.mkv", "a.ts"])
def test_one_frame_a_second_by_presentation_time(tmp_path: Path, name: str) -> None:
    frames = read(write_film(tmp_path / name, [40 * i for i in range(60)]))
    assert numbers(frames) == [0, 25, 50]
    assert [p.time_s for p in frames] == pytest.approx([0, 1, 2])
    assert [p.name for p in frames] == ["a#0", "a#1", "a#2"]
    assert {(p.width, p.height) for p in frames} == {(64, 48)}


def test_variable_frame_rate(tmp_path: Path) -> None:
    """At 1, 2, ... 9 s the nearest frames are at 0.9, 1.15, 5.0 (for 4 and 5), 5.05 and 9.0 s."""
    path = write_film(tmp_path / "a.mp4", [0, 100, 900, 1150, 5000, 5050, 9000])
    frames = read(path)
    assert numbers(frames) == [0, 2, 3, 4, 5, 6]
    assert [p.time_s for p in frames] == pytest.approx([0, 0.9, 1.15, 5.0, 5.05, 9.0])


def test_times_count_from_the_first_frame(tmp_path: Path) -> None:
    path = write_film(tmp_path / "a.mkv", [7000 + 500 * i for i in range(5)])
    assert [p.time_s for p in read(path)] == pytest.approx([0, 1, 2])


def test_a_rate_above_the_videos_takes_each_frame_once(tmp_path: Path) -> None:
    path = write_film(tmp_path / "a.mp4", [40 * i for i in range(20)])
    assert numbers(read(path, fps=1000)) == list(range(20))


def test_b_frames_come_in_presentation_order(tmp_path: Path) -> None:
    path = write_film(tmp_path / "a.mp4", [40 * i for i in range(30)], codec_options={"bf": "2"})
    assert numbers(read(path, fps=25)) == list(range(30))


def test_ranges_split_a_video_without_overlap_or_gap(tmp_path: Path) -> None:
    path = write_film(tmp_path / "a.mp4", [40 * i for i in range(50)])
    first = numbers(read(path, fps=25, end_s=0.8))
    second = numbers(read(path, fps=25, start_s=0.8))
    assert first == list(range(20))
    assert second == list(range(20, 50))
    later = read(path, fps=2, start_s=0.5, end_s=1.6)
    assert numbers(later) == [13, 25, 37]
    assert [p.time_s for p in later] == pytest.approx([0.52, 1.0, 1.48])


def test_a_range_beyond_the_end_names_the_end(tmp_path: Path) -> None:
    path = write_film(tmp_path / "a.mp4", [40 * i for i in range(26)])
    with pytest.raises(InputError, match=r"range from 5 s to 6 s.*up to 1\.00 s"):
        read(path, start_s=5, end_s=6)


@pytest.mark.parametrize("fps", [0, -1, float("nan"), float("inf")])
def test_impossible_rates_are_refused(fps: float) -> None:
    with pytest.raises(InputError, match="frame rate"):
        Sampling(fps=fps)


@pytest.mark.parametrize(("start", "end"), [(-1, None), (2, 2), (2, 1), (0, float("nan"))])
def test_impossible_ranges_are_refused(start: float, end: float | None) -> None:
    with pytest.raises(InputError, match="range"):
        Sampling(start_s=start, end_s=end)


@given(
    gaps=st.lists(st.integers(1, 300), min_size=1, max_size=30),
    period=st.integers(1, 400),
    start=st.integers(0, 500),
    length=st.none() | st.integers(1, 2000),
)
def test_sampling_agrees_with_a_search_over_all_frames(
    gaps: list[int], period: int, start: int, length: int | None
) -> None:
    """Whole seconds, so that the search below is exact."""
    times = list(itertools.accumulate(gaps, initial=0))
    end = None if length is None else start + length
    kept = [t for t in times if t >= start and (end is None or t < end)]
    wanted: list[int] = []
    for due in range(start, (kept[-1] if kept else -1) + 1, period):
        nearest = min(kept, key=lambda t: (abs(t - due), t))
        if nearest not in wanted:
            wanted.append(nearest)
    sampling = Sampling(1 / period, start, end)
    got = list(nearest_in_time(((float(t), t) for t in times), sampling))
    assert [item for _, item in got] == wanted


def test_sampling_survives_absurd_time_stamps() -> None:
    timed = iter([(0.0, "a"), (1.0, "b"), (1e13, "c")])
    assert [item for _, item in nearest_in_time(timed, Sampling())] == ["a", "b", "c"]


MATRICES = {  # a b c d of (x, y) -> (a x + c y, b x + d y), and the same turn in NumPy
    "upright": ((1, 0, 0, 1), lambda p: p),
    "clockwise": ((0, 1, -1, 0), lambda p: np.rot90(p, -1)),
    "half": ((-1, 0, 0, -1), lambda p: np.rot90(p, 2)),
    "counter-clockwise": ((0, -1, 1, 0), lambda p: np.rot90(p)),
    "mirrored": ((-1, 0, 0, 1), lambda p: p[:, ::-1]),
    "upside down": ((1, 0, 0, -1), lambda p: p[::-1]),
    "transposed": ((0, 1, 1, 0), lambda p: p.swapaxes(0, 1)),
    "transposed, turned": ((0, -1, -1, 0), lambda p: np.rot90(p.swapaxes(0, 1), 2)),
}


@pytest.mark.parametrize("name", MATRICES)
def test_display_matrix_is_honoured(tmp_path: Path, name: str) -> None:
    (a, b, c, d), turn = MATRICES[name]
    matrix = (a * ONE, b * ONE, 0, c * ONE, d * ONE, 0, 0, 0, 1 << 30)
    plain = read(write_film(tmp_path / "plain.mp4", [0, 1000]))
    turned = read(write_film(tmp_path / "turned.mp4", [0, 1000], matrix=matrix))
    for before, after in zip(plain, turned, strict=True):
        assert (after.image == turn(before.image)).all()
        assert (after.height, after.width) == after.image.shape[:2]


@pytest.mark.parametrize("fast_start", [True, False])
def test_cut_short_anywhere_gives_frames_or_a_clear_error(tmp_path: Path, fast_start: bool) -> None:
    options = {"movflags": "faststart"} if fast_start else {}
    whole = write_film(tmp_path / "a.mp4", [200 * i for i in range(40)], container_options=options)
    data = whole.read_bytes()
    path = tmp_path / "cut.mp4"
    counts = []
    for length in range(0, len(data), len(data) // 30):
        path.write_bytes(data[:length])
        warnings: list[str] = []
        counts.append(len(times_or_refusal(path, warnings.append)))
        assert counts[-1] in (0, 8) or warnings
    assert counts == sorted(counts)
    assert (counts[len(counts) // 2] > 0) == fast_start  # else the index, at the end, is missing


def test_random_damage_gives_frames_or_a_clear_error(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for name in ("a.mp4", "a.avi", "a.mkv", "a.ts"):
        path = write_film(tmp_path / name, [200 * i for i in range(10)])
        data = np.frombuffer(path.read_bytes(), np.uint8)
        for _ in range(15):
            damaged = data.copy()
            damaged[rng.integers(0, len(data), 8)] = rng.integers(0, 256, 8)
            path.write_bytes(damaged.tobytes())
            times = times_or_refusal(path)
            assert times == sorted(times)


def test_a_header_that_promises_too_much_is_a_warning(tmp_path: Path) -> None:
    path = write_film(tmp_path / "a.mkv", [40 * i for i in range(50)])
    data = path.read_bytes()
    at = data.index(b"\x44\x89\x88") + 3  # Matroska's duration: a double, in milliseconds
    path.write_bytes(data[:at] + struct.pack(">d", 60000.0) + data[at + 8 :])
    warnings: list[str] = []
    assert len(read(path, warn=warnings.append)) == 2
    assert len(warnings) == 1
    assert "ends at 2.0 s" in warnings[0]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"just some words\n" * 50, "neither a picture nor a video"),
        (b"#EXTM3U\nhttp://example.invalid/a.ts\n", "neither a picture nor a video"),
        (b"ffconcat version 1.0\nfile /etc/passwd\n", "neither a picture nor a video"),
    ],
)
def test_what_is_no_video_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "film.mp4"
    path.write_bytes(content)
    with pytest.raises(InputError, match=rf"film\.mp4.*{message}"):
        read(path)


def test_sound_alone_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"a\.m4a has no picture track"):
        read(write_sound(tmp_path / "a.m4a"))


def test_colours_survive(tmp_path: Path) -> None:
    picture = np.full((48, 64, 3), (200, 60, 30), np.uint8)
    picture[:, 32:] = 20, 120, 220
    path = write_film(tmp_path / "a.mp4", [0, 1000], [picture, picture])
    image = read(path)[0].image
    assert np.abs(image[:, 8:24].mean(axis=(0, 1)) - (200, 60, 30)).max() < 6
    assert np.abs(image[:, 40:56].mean(axis=(0, 1)) - (20, 120, 220)).max() < 6
