"""Masks and labels in pictures."""

import io

import numpy as np
import pytest
from PIL import Image

from scenediff_classic.masks import encode
from scenediff_classic.report import write_overlays
from scenediff_classic.report.drawing import Mark, _overlap, _place, draw_marks, mask_at
from scenediff_classic.report.embedded import fit
from scenediff_classic.report.palette import INK, KIND_COLOUR
from scenediff_classic.types import ObjectView
from tests.report.example import example


def view_of(mask: np.ndarray) -> ObjectView:
    return ObjectView("before", 0, 0.5, (0.0, 0.0, 1.0, 1.0), encode(mask))


def square(height: int, width: int, top: int, left: int, side: int) -> np.ndarray:
    mask = np.zeros((height, width), bool)
    mask[top : top + side, left : left + side] = True
    return mask


def luminance(colour: tuple[int, int, int]) -> float:
    """WCAG 2.2 relative luminance."""
    c = np.array(colour) / 255
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_the_contract_s_colours() -> None:
    assert KIND_COLOUR == {
        "removed": (255, 51, 51),
        "added": (51, 204, 102),
        "moved": (0, 153, 255),
    }


@pytest.mark.parametrize("colour", KIND_COLOUR.values(), ids=list(KIND_COLOUR))
def test_labels_have_the_contrast_that_small_text_needs(colour: tuple[int, int, int]) -> None:
    contrast = (luminance(colour) + 0.05) / (luminance(INK) + 0.05)
    assert contrast >= 4.5


def test_a_mask_keeps_its_place_when_the_picture_is_smaller() -> None:
    mask = square(40, 80, 8, 16, 16)
    np.testing.assert_array_equal(mask_at(view_of(mask), 40, 80), mask)
    np.testing.assert_array_equal(mask_at(view_of(mask), 20, 40), square(20, 40, 4, 8, 8))


def test_a_thin_mask_survives_the_reduction() -> None:
    mask = np.zeros((64, 64), bool)
    mask[:, 33] = True
    small = mask_at(view_of(mask), 8, 8)
    assert small[:, 4].all()
    assert small.sum() == 8


def test_an_empty_mask_stays_empty() -> None:
    assert not mask_at(view_of(np.zeros((64, 64), bool)), 8, 8).any()


def test_paint_is_translucent_inside_and_leaves_the_rest_alone() -> None:
    image = np.full((60, 80, 3), 100, np.uint8)
    original = image.copy()
    mask = square(60, 80, 20, 30, 20)
    painted = draw_marks(image, (Mark(0, "removed", mask),), labels=False)
    np.testing.assert_array_equal(image, original)
    red, green, blue = painted[30, 40].tolist()
    assert 100 < red < 255
    assert 51 < green < 100
    assert green == blue
    far = ~square(60, 80, 16, 26, 28)
    np.testing.assert_array_equal(painted[far], original[far])


def test_the_small_object_is_painted_over_the_large_one() -> None:
    image = np.full((60, 80, 3), 100, np.uint8)
    large, small = square(60, 80, 5, 5, 50), square(60, 80, 20, 20, 10)
    one = (Mark(0, "removed", large), Mark(1, "moved", small))
    painted = draw_marks(image, one, labels=False)
    assert painted[25, 25, 2] > painted[10, 40, 2]
    np.testing.assert_array_equal(painted, draw_marks(image, one[::-1], labels=False))


def test_labels_stay_inside_and_apart() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        width, height = (int(side) for side in rng.integers(80, 200, 2))
        taken = []
        for _ in range(3):
            left, top = int(rng.integers(0, width - 8)), int(rng.integers(0, height - 8))
            target = (left, top, left + 8, top + 8)
            box = _place(target, (40, 12), width, height, taken)
            assert (box[2] - box[0], box[3] - box[1]) == (40, 12)
            assert box[0] >= 0
            assert box[1] >= 0
            assert box[2] <= width
            assert box[3] <= height
            taken.append(box)


def test_two_objects_at_one_place_get_labels_that_can_both_be_read() -> None:
    target = (50, 50, 70, 70)
    first = _place(target, (40, 12), 200, 200, [])
    second = _place(target, (40, 12), 200, 200, [first])
    assert _overlap(first, target) == 0
    assert _overlap(first, second) == 0


def test_fit_never_enlarges() -> None:
    image = np.zeros((30, 40, 3), np.uint8)
    assert fit(image, 100) is image
    assert fit(image, 20).shape == (15, 20, 3)


def test_overlays_one_per_frame(tmp_path) -> None:
    made = example()
    told = []
    written = write_overlays(
        made.result, made.before, made.after, tmp_path / "overlays",
        lambda stage, done, total: told.append((stage, done, total)),
    )  # fmt: skip
    names = [f"{video}_{i:05d}.jpg" for video in ("before", "after") for i in range(4)]
    assert [path.name for path in written] == names
    assert sorted(p.name for p in (tmp_path / "overlays").iterdir()) == sorted(names)
    assert told[-1] == ("overlays", 8, 8)
    frame = made.after.frames[1]
    picture = np.asarray(Image.open(io.BytesIO(written[5].read_bytes()))).astype(int)
    assert picture.shape == frame.image.shape
    added = next(item for item in made.result.objects if item.kind == "added")
    seen = next(view for view in added.views if view.frame == 1)
    inside = mask_at(seen, *frame.image.shape[:2])
    assert np.abs(picture - frame.image)[inside].mean() > 20
    unpainted = np.ones_like(inside)
    for item in made.result.objects:
        for view in item.views:
            if (view.video, view.frame) == ("after", 1):
                x, y, w, h = (int(v) for v in view.bbox)
                unpainted[max(y - 20, 0) : y + h + 20, max(x - 20, 0) : x + w + 45] = False
    assert np.abs(picture - frame.image)[unpainted].mean() < 4


def test_a_lost_frame_says_so(tmp_path) -> None:
    made = example()
    written = write_overlays(made.result, made.before, made.after, tmp_path)
    lost = np.asarray(Image.open(io.BytesIO(written[3].read_bytes()))).astype(int)
    corner, opposite = lost[-6:, :40], lost[:20, -20:]
    assert np.ptp(corner) > 60
    assert np.ptp(opposite) < 10
