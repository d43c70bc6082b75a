"""Photos: every mode and depth, orientation, focal length, order, damage."""

from pathlib import Path
from random import Random

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ExifTags, Image, ImageOps

from scenediff_classic import photos, pictures
from scenediff_classic.errors import InputError
from scenediff_classic.photos import (
    focal_from_exif,
    is_photo,
    list_photos,
    natural_key,
    read_mask,
    read_photo,
)

HEIGHT, WIDTH = 24, 40
BASE = ExifTags.Base


def colours() -> np.ndarray:
    """A small picture without any symmetry."""
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    picture[..., 0] = np.linspace(0, 255, WIDTH)[None]
    picture[..., 1] = np.linspace(0, 255, HEIGHT)[:, None]
    picture[:8, :8] = 200, 30, 90
    return picture


def save(picture: Image.Image, path: Path, **options) -> Path:
    picture.save(path, **options)
    return path


def with_exif(path: Path, size: tuple[int, int] = (WIDTH, HEIGHT), **tags: object) -> Path:
    """A JPEG with the given tags, by their EXIF names."""
    picture = Image.fromarray(colours()).resize(size)
    exif = picture.getexif()
    for name, value in tags.items():
        block = exif if name == "Orientation" else exif.get_ifd(ExifTags.IFD.Exif)
        block[BASE[name]] = value
    return save(picture, path, exif=exif, quality=95)


def readable(path: Path) -> bool:
    """Whether a photo can be read; if not, the sentence must name it."""
    try:
        return read_photo(path, 100).image.ndim == 3
    except InputError as error:
        refusal = str(error)
    assert str(path) in refusal
    return False


@pytest.mark.parametrize("suffix", ["png", "tiff", "bmp", "ppm", "webp"])
def test_rgb_is_read_unchanged_from_lossless_formats(tmp_path: Path, suffix: str) -> None:
    path = save(Image.fromarray(colours()), tmp_path / f"a.{suffix}", lossless=True)
    photo = read_photo(path, 1000)
    assert (photo.image == colours()).all()
    assert (photo.name, photo.width, photo.height) == (f"a.{suffix}", WIDTH, HEIGHT)
    assert photo.time_s is None
    assert photo.focal_px is None


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGBA", "CMYK"])
@pytest.mark.parametrize("suffix", ["png", "tiff", "jpg", "webp"])
def test_every_mode_becomes_rgb(tmp_path: Path, mode: str, suffix: str) -> None:
    grey = np.repeat(colours().mean(axis=-1, keepdims=True).astype(np.uint8), 3, axis=2)
    colour = colours()
    source = Image.fromarray(grey if mode in ("1", "L", "LA") else colour)
    expected = np.array(source.convert("1").convert("RGB")) if mode == "1" else np.array(source)
    path = tmp_path / f"a.{suffix}"
    try:
        source.convert(mode).save(path, quality=100)
    except (OSError, KeyError):
        with pytest.raises((OSError, KeyError)):  # this format has no such mode
            source.convert(mode).save(tmp_path / f"b.{suffix}")
        return
    difference = np.abs(read_photo(path, 1000).image.astype(int) - expected)
    assert difference.mean() < (20 if mode == "P" else 3)


def test_alpha_is_dropped_not_blended(tmp_path: Path) -> None:
    pixels = np.dstack([colours(), np.zeros((HEIGHT, WIDTH), np.uint8)])
    path = save(Image.fromarray(pixels), tmp_path / "a.png")
    assert (read_photo(path, 1000).image == colours()).all()


def test_transparent_palette_is_read_without_a_warning(tmp_path: Path) -> None:
    picture = Image.fromarray(colours()).convert("P")
    picture.info["transparency"] = bytes(range(256))
    assert read_photo(save(picture, tmp_path / "a.png"), 1000).image.shape == (HEIGHT, WIDTH, 3)


@pytest.mark.parametrize("suffix", ["png", "tiff"])
def test_sixteen_bits_scale_to_eight(tmp_path: Path, suffix: str) -> None:
    values = np.linspace(0, 65535, HEIGHT * WIDTH).reshape(HEIGHT, WIDTH).astype(np.uint16)
    path = tmp_path / f"a.{suffix}"
    assert cv2.imwrite(str(path), values)
    photo = read_photo(path, 1000)
    assert (photo.image == np.rint(values / 257).astype(np.uint8)[..., None]).all()


@pytest.mark.parametrize("suffix", ["png", "tiff"])
def test_sixteen_bit_colour_is_right_within_one_level(tmp_path: Path, suffix: str) -> None:
    values = colours().astype(np.uint16) * 257
    values[..., 2] = 12345
    path = tmp_path / f"a.{suffix}"
    assert cv2.imwrite(str(path), values[..., ::-1])
    difference = read_photo(path, 1000).image.astype(float) - values / 257
    assert np.abs(difference).max() <= 1


def test_floating_point_pictures_are_refused(tmp_path: Path) -> None:
    path = save(Image.fromarray(np.ones((HEIGHT, WIDTH), np.float32)), tmp_path / "a.tiff")
    with pytest.raises(InputError, match="floating-point"):
        read_photo(path, 1000)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", ["jpg", "tiff"])
def test_orientation_agrees_with_pillow(tmp_path: Path, orientation: int, suffix: str) -> None:
    path = with_exif(tmp_path / f"a.{suffix}", Orientation=orientation)
    with Image.open(path) as picture:
        expected = np.array(ImageOps.exif_transpose(picture))
    photo = read_photo(path, 1000)
    assert (photo.image == expected).all()
    assert (photo.height, photo.width) == expected.shape[:2]


def test_sixth_orientation_turns_clockwise(tmp_path: Path) -> None:
    """Worked by hand, as the test above shares its meaning of the tag with Pillow."""
    path = with_exif(tmp_path / "a.jpg", Orientation=6)
    corner = read_photo(path, 1000).image[2, -3].astype(int)  # the block from the upper left
    assert np.abs(corner - (200, 30, 90)).max() < 40


def test_large_pictures_are_averaged_down(tmp_path: Path) -> None:
    pixels = np.kron([[0, 255] * 20, [255, 0] * 20] * 12, np.ones((2, 2))).astype(np.uint8)
    path = save(Image.fromarray(pixels).convert("RGB"), tmp_path / "a.png")
    photo = read_photo(path, 20)
    assert photo.image.shape == (12, 20, 3)
    assert (photo.width, photo.height) == (80, 48)
    assert np.ptp(photo.image) <= 1  # averaged, not point-sampled
    assert read_photo(path, 81).image.shape == (48, 80, 3)  # never enlarged


def test_focal_from_35mm_equivalent(tmp_path: Path) -> None:
    """A phone with 26 mm equivalent; 4.25 mm on 1.40 um pixels is 3036 px, within rounding."""
    exif = Image.Exif()
    exif.get_ifd(ExifTags.IFD.Exif)[BASE.FocalLengthIn35mmFilm] = 26
    assert focal_from_exif(exif, 4032, 3024) == pytest.approx(3028.7, abs=0.1)
    assert focal_from_exif(exif, 3000, 2000) == pytest.approx(3000 * 26 / 36, abs=1e-9)


@pytest.mark.parametrize(("unit", "density"), [(2, 5080.0), (3, 2000.0), (4, 200.0), (5, 0.2)])
def test_focal_from_sensor_resolution(tmp_path: Path, unit: int, density: float) -> None:
    """8 mm at 200 pixels a millimetre are 1600 px in the full picture, half that in a copy."""
    tags = {
        "FocalLength": 8.0,
        "FocalPlaneXResolution": density,
        "FocalPlaneResolutionUnit": unit,
        "ExifImageWidth": 2000,
        "ExifImageHeight": 1000,
    }
    path = with_exif(tmp_path / "a.jpg", (1000, 500), **tags)
    assert read_photo(path, 100).focal_px == pytest.approx(800, rel=1e-4)


@pytest.mark.parametrize(
    "tags",
    [
        {"FocalLengthIn35mmFilm": 0},
        {"FocalLength": 8.0},
        {"FocalLengthIn35mmFilm": 60000},
        {"FocalLengthIn35mmFilm": 26, "ExifImageWidth": 100, "ExifImageHeight": 24},  # cropped
        {"FocalLengthIn35mmFilm": 26, "DigitalZoomRatio": 2.0},
    ],
)
def test_focal_that_cannot_be_trusted_is_unknown(tmp_path: Path, tags: dict) -> None:
    assert read_photo(with_exif(tmp_path / "a.jpg", **tags), 100).focal_px is None


def test_broken_exif_does_not_cost_the_picture(tmp_path: Path) -> None:
    path = with_exif(tmp_path / "a.jpg", Orientation=1, FocalLengthIn35mmFilm=26)
    data = path.read_bytes()
    start = data.index(b"Exif\0\0") + 6
    for offset in range(8, 40):
        broken = tmp_path / f"{offset}.jpg"
        broken.write_bytes(data[: start + offset] + b"\xff" + data[start + offset + 1 :])
        assert read_photo(broken, 100).image.shape[2] == 3


@given(st.lists(st.text("aB0129_ é", max_size=6), max_size=8), st.randoms())
def test_natural_order_ignores_how_the_folder_is_listed(names: list[str], random: Random) -> None:
    shuffled = random.sample(names, len(names))
    assert sorted(shuffled, key=natural_key) == sorted(names, key=natural_key)


@given(st.text("xy-", max_size=4), st.integers(0, 10**9), st.integers(0, 10**9))
def test_natural_order_is_by_value(prefix: str, first: int, second: int) -> None:
    in_order = natural_key(f"{prefix}{first}.png") <= natural_key(f"{prefix}{second}.png")
    assert in_order == (first <= second)


def test_listing_is_natural_and_leaves_out_what_is_no_picture(tmp_path: Path) -> None:
    for name in ("img10.png", "IMG2.png", "img1.JPG", "Größe 3.png", ".hidden.png", "img1.dng"):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "folder.png").mkdir()
    warnings: list[str] = []
    names = [p.name for p in list_photos(tmp_path, warnings.append)]
    assert names == ["Größe 3.png", "img1.JPG", "IMG2.png", "img10.png"]
    assert len(warnings) == 1
    assert "notes.txt" in warnings[0]


def test_a_raw_picture_alone_is_refused(tmp_path: Path) -> None:
    save(Image.fromarray(colours()), tmp_path / "a.png")
    (tmp_path / "b.HEIC").write_bytes(b"x")
    with pytest.raises(InputError, match=r"b\.HEIC.*convert"):
        list_photos(tmp_path, print)


@pytest.mark.parametrize("suffix", ["png", "jpg", "webp", "tiff"])
def test_cut_short_anywhere_is_a_clear_error(tmp_path: Path, suffix: str) -> None:
    data = save(Image.fromarray(colours()), tmp_path / f"whole.{suffix}").read_bytes()
    path = tmp_path / f"cut.{suffix}"
    refused = 0
    for length in range(0, len(data), max(len(data) // 40, 1)):
        path.write_bytes(data[:length])
        refused += not readable(path)
    assert refused > 30


def test_random_damage_is_read_or_refused_but_never_crashes(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for suffix in ("png", "jpg", "tiff", "webp", "gif", "bmp"):
        path = tmp_path / f"a.{suffix}"
        data = np.frombuffer(save(Image.fromarray(colours()), path).read_bytes(), np.uint8)
        for _ in range(30):
            damaged = data.copy()
            damaged[rng.integers(0, len(data), 5)] = rng.integers(0, 256, 5)
            path.write_bytes(damaged.tobytes())
            readable(path)


def test_huge_pictures_are_refused_before_decoding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(Image.fromarray(colours()), tmp_path / "a.png")
    monkeypatch.setattr(pictures, "MAX_PIXELS", HEIGHT * WIDTH - 1)
    with pytest.raises(InputError, match=r"a\.png has 40 x 24 pixels, more than"):
        read_photo(path, 100)
    monkeypatch.setattr(photos.Image, "MAX_IMAGE_PIXELS", 10)  # Pillow's own guard
    with pytest.raises(InputError, match="too many pixels"):
        read_photo(path, 100)
    assert is_photo(path)


def test_tiny_pictures_are_refused(tmp_path: Path) -> None:
    path = save(Image.fromarray(colours()[:4, :4]), tmp_path / "a.png")
    with pytest.raises(InputError, match="only 4 x 4"):
        read_photo(path, 100)


def test_masks_count_whatever_is_not_zero(tmp_path: Path) -> None:
    values = np.zeros((HEIGHT, WIDTH), np.uint8)
    values[3:9, 5:20] = 1
    grey = save(Image.fromarray(values), tmp_path / "grey.png")
    palette = Image.fromarray(values).convert("P")
    palette.putpalette([10, 10, 10, 0, 0, 0])  # the indices count, not their colours
    indexed = save(palette, tmp_path / "palette.png")
    opaque = np.dstack([values] * 3 + [np.full_like(values, 255)])
    alpha = save(Image.fromarray(opaque), tmp_path / "alpha.png")
    for path in (grey, indexed, alpha):
        assert (read_mask(path) == (values > 0)).all()
