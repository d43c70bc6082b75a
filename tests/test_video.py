"""Captures as a whole: what is accepted, what is refused and how, masks, fingerprints."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenediff_classic import video as video_module
from scenediff_classic.errors import InputError
from scenediff_classic.types import Capture
from scenediff_classic.video import fingerprint, read_capture
from tests.films import number_in, numbered, write_film
from tests.privileges import as_nobody


def write_photo(path: Path, number: int = 5, **size: int) -> Path:
    Image.fromarray(numbered(number, **size)).save(path)
    return path


def write_mask(path: Path, height: int, width: int) -> Path:
    """A mask whose left half is hidden."""
    mask = np.zeros((height, width), np.uint8)
    mask[:, : width // 2] = 255
    Image.fromarray(mask).save(path)
    return path


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    """Three photos whose names sort differently as text; one has another size."""
    folder = tmp_path / "Fotos für später"
    folder.mkdir()
    write_photo(folder / "img10.png", 10)
    write_photo(folder / "img2.png", 2, height=96, width=128)
    write_photo(folder / "img1.png", 1)
    return folder


def test_a_folder_of_photos(photos: Path) -> None:
    calls: list[tuple[str, int, int]] = []
    capture = read_capture(photos, "after", progress=lambda *call: calls.append(call))
    assert [f.name for f in capture.frames] == ["img1.png", "img2.png", "img10.png"]
    assert [number_in(f.image) for f in capture.frames] == [1, 2, 10]
    assert [f.index for f in capture.frames] == [0, 1, 2]
    assert [(f.width, f.height) for f in capture.frames] == [(64, 48), (128, 96), (64, 48)]
    assert {f.video for f in capture.frames} == {"after"}
    assert capture.warnings == ()
    assert capture.source == str(photos)
    assert calls == [("read after", done, 3) for done in (1, 2, 3)]


def test_one_photo_without_a_suffix(tmp_path: Path) -> None:
    path = write_photo(tmp_path / "a.png").rename(tmp_path / "a")
    capture = read_capture(path, "before", max_long_side=32)
    assert len(capture.frames) == 1
    assert capture.frames[0].image.shape == (24, 32, 3)
    assert (capture.frames[0].width, capture.frames[0].height) == (64, 48)


def test_a_video(tmp_path: Path) -> None:
    totals: set[int] = set()
    path = write_film(tmp_path / "küche 1.mp4", [40 * i for i in range(60)])
    capture = read_capture(path, "before", progress=lambda _s, _d, total: totals.add(total))
    assert [f.name for f in capture.frames] == ["küche 1#0", "küche 1#1", "küche 1#2"]
    assert [f.time_s for f in capture.frames] == pytest.approx([0, 1, 2])
    assert totals == {3}


def test_photos_and_videos_give_the_same_twice(photos: Path, tmp_path: Path) -> None:
    path = write_film(tmp_path / "a.mp4", [40 * i for i in range(60)])
    for source in (photos, path):
        first, second = (read_capture(source, "before") for _ in range(2))
        for a, b in zip(first.frames, second.frames, strict=True):
            assert (a.image == b.image).all()


def test_pictures_are_ordinary_arrays(photos: Path, tmp_path: Path) -> None:
    path = write_film(tmp_path / "a.mp4", [0, 1000])
    for frame in (*read_capture(photos, "before").frames, *read_capture(path, "before").frames):
        assert frame.image.flags.writeable
        assert frame.image.flags.c_contiguous


def black(path: Path) -> None:
    Image.fromarray(np.zeros((48, 64, 3), np.uint8)).save(path)


def nothing(path: Path) -> None:
    """Leave the path missing."""


def empty_folder(path: Path) -> None:
    path.mkdir()


def folder_of_text(path: Path) -> None:
    path.mkdir()
    (path / "notes.txt").write_text("hello")


def folder_of_videos(path: Path) -> None:
    path.mkdir()
    write_film(path / "a.mp4", [0, 1000])


def folder_with_damage(path: Path) -> None:
    path.mkdir()
    write_photo(path / "a.png")
    (path / "b.png").write_bytes((path / "a.png").read_bytes()[:60])


def folder_with_empty_file(path: Path) -> None:
    path.mkdir()
    (path / "b.png").touch()


def black_film(path: Path) -> None:
    write_film(path, [0, 1000], [np.zeros((48, 64, 3), np.uint8)] * 2)


def pipe(path: Path) -> None:
    os.mkfifo(path)


@pytest.mark.parametrize(
    ("name", "make", "message"),
    [
        ("a.mp4", nothing, r"a\.mp4 does not exist"),
        ("a", empty_folder, r"a is an empty folder"),
        ("a", folder_of_text, r"a holds no pictures"),
        ("a", folder_of_videos, r"holds videos, not pictures: give one video.*a\.mp4"),
        ("a", folder_with_damage, r"b\.png is a damaged picture"),
        ("a", folder_with_empty_file, r"b\.png is empty"),
        ("a.mp4", Path.touch, r"a\.mp4 is empty"),
        ("a.png", Path.touch, r"a\.png is empty"),
        ("a.mp4", lambda p: p.write_text("words"), r"a\.mp4 is neither a picture nor a video"),
        ("a.jpg", lambda p: p.write_text("words"), r"a\.jpg is not a picture"),
        ("a.heic", lambda p: p.write_text("words"), r"a\.heic is a HEIC picture.*convert"),
        ("a.png", black, r"a\.png is entirely black"),
        ("a.mp4", black_film, r"a\.mp4 holds 2 frames, all entirely black"),
        ("a", pipe, r"a is neither a file nor a folder"),
    ],
)
def test_bad_input_is_one_clear_sentence(tmp_path: Path, name: str, make, message: str) -> None:
    make(tmp_path / name)
    with pytest.raises(InputError, match=message) as caught:
        read_capture(tmp_path / name, "before")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("options", [{"fps": 0}, {"max_long_side": 2}, {"start_s": 3, "end_s": 1}])
def test_bad_options_are_refused(photos: Path, options: dict) -> None:
    with pytest.raises(InputError, match=r"must"):
        read_capture(photos, "before", **options)


def test_a_range_of_photos_is_refused(photos: Path) -> None:
    with pytest.raises(InputError, match="no video"):
        read_capture(photos, "before", end_s=2.0)


def test_unreadable_files_are_named() -> None:
    """In a folder of its own, as pytest's are closed to other users."""
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        photo = write_photo(folder / "a.png")
        film = write_film(folder / "b.mp4", [0, 1000])
        closed = folder / "closed"
        closed.mkdir()
        for path in (photo, film, closed):
            path.chmod(0)
        with as_nobody():
            for path in (photo, film, closed, closed / "inner.png"):
                with pytest.raises(InputError, match=rf"{path.name} cannot be.*denied"):
                    read_capture(path, "before")
            with pytest.raises(InputError, match=r"a\.png cannot be read"):
                fingerprint(photo)


def test_one_black_frame_among_others_is_a_warning(photos: Path) -> None:
    black(photos / "img3.png")
    capture = read_capture(photos, "before")
    assert len(capture.frames) == 4
    assert len(capture.warnings) == 1
    assert "img3.png" in capture.warnings[0]


def test_too_many_frames_for_the_memory_are_refused(
    photos: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(video_module, "MAX_CAPTURE_BYTES", 2 * 96 * 128 * 3)
    assert len(read_capture(photos, "before").frames) == 3
    monkeypatch.setattr(video_module, "MAX_CAPTURE_BYTES", 20_000)
    with pytest.raises(InputError, match="after 1 frames"):
        read_capture(photos, "before")


def hidden(capture: Capture) -> list[float | None]:
    """Share of each frame that its mask hides; None without a mask."""
    return [None if f.ignore is None else float(f.ignore.mean()) for f in capture.frames]


def test_masks_belong_to_photos_by_name(photos: Path, tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    masks.mkdir()
    write_mask(masks / "img2.png", 48, 64)  # half the photo's size
    write_mask(masks / "img10.png", 96, 128)
    write_mask(masks / "1.png", 48, 64)
    capture = read_capture(photos, "before", max_long_side=100, ignore_dir=masks)
    assert hidden(capture) == [None, 0.5, 0.5]
    for frame in capture.frames[1:]:
        assert frame.ignore is not None
        assert frame.ignore.shape == frame.image.shape[:2]
        assert frame.ignore[:, 0].all()
    assert capture.warnings == ()


def test_masks_belong_to_video_frames_by_number(tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    masks.mkdir()
    write_mask(masks / "0001.png", 48, 64)
    path = write_film(tmp_path / "a.mp4", [40 * i for i in range(60)])
    assert hidden(read_capture(path, "before", ignore_dir=masks)) == [None, 0.5, None]


def test_masks_that_fit_no_frame_are_a_warning(photos: Path, tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    masks.mkdir()
    write_mask(masks / "other.png", 48, 64)
    capture = read_capture(photos, "before", ignore_dir=masks)
    assert len(capture.warnings) == 1
    assert "img1.png" in capture.warnings[0]


def test_a_mask_of_another_shape_is_refused(photos: Path, tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    masks.mkdir()
    write_mask(masks / "img2.png", 64, 48)
    with pytest.raises(InputError, match=r"img2\.png has 48 x 64 pixels.*128 x 96"):
        read_capture(photos, "before", ignore_dir=masks)
    with pytest.raises(InputError, match="not a folder of mask"):
        read_capture(photos, "before", ignore_dir=tmp_path / "missing")


def test_fingerprints_tell_names_and_contents_apart(photos: Path, tmp_path: Path) -> None:
    seen = {fingerprint(photos)}
    write_photo(photos / "img1.png", 7)
    seen.add(fingerprint(photos))
    (photos / "img1.png").rename(photos / "img01.png")
    seen.add(fingerprint(photos))
    (photos / "img2.png").unlink()
    seen.add(fingerprint(photos))
    seen.add(fingerprint(photos / "img10.png"))
    assert len(seen) == 5
    copy = tmp_path / "copy"
    photos.rename(copy)
    (copy / ".hidden").touch()
    (copy / "img10.png").touch()
    assert fingerprint(copy) in seen
    with pytest.raises(InputError, match="does not exist"):
        fingerprint(photos)


def test_the_real_video_gives_a_frame_a_second(real_data: Path) -> None:
    """The first 1000 frames of 7-Scenes' RedKitchen at 30 frames a second: 33.3 s."""
    path = real_data / "videos" / "redkitchen_1000f_30fps.mp4"
    capture = read_capture(path, "before", max_long_side=64)
    assert [f.time_s for f in capture.frames] == pytest.approx(range(34))
    assert capture.warnings == ()
    assert {(f.width, f.height) for f in capture.frames} == {(640, 480)}
    part = read_capture(path, "after", max_long_side=64, start_s=1.5, end_s=3.5)
    assert [f.time_s for f in part.frames] == pytest.approx([1.5, 2.5])
