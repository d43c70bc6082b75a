"""Run-length masks against pixels, torch's resize, and damaged input."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from scenediff_classic import masks
from scenediff_classic.errors import InputError
from scenediff_classic.types import Rle

pictures = npst.arrays(bool, npst.array_shapes(min_dims=2, max_dims=2, max_side=24))


@given(pictures)
def test_round_trip(mask):
    rle = masks.encode(mask)
    assert rle.size == mask.shape
    assert np.array_equal(masks.decode(rle), mask)
    assert masks.verified(list(rle.size), rle.counts, "here") == rle


def test_golden_counts():
    """By hand: runs 9, 2, 2, 2, 5 of 4 x 5 pixels; the last two are told from those two before."""
    mask = np.zeros((4, 5), bool)
    mask[1:3, 2:4] = True
    assert masks.encode(mask) == Rle((4, 5), "92203")
    assert masks.run_lengths(Rle((4, 5), "92203")).tolist() == [9, 2, 2, 2, 5]


@given(pictures)
def test_run_lengths_are_those_of_the_pixels(mask):
    flat = mask.ravel(order="F")
    ends = np.r_[np.flatnonzero(np.diff(flat.astype(int))) + 1, flat.size]
    expected = np.diff(np.r_[0, ends])
    if flat[0]:
        expected = np.r_[0, expected]
    assert masks.run_lengths(masks.encode(mask)).tolist() == expected.tolist()


def test_run_lengths_of_large_runs():
    mask = np.zeros((3000, 4000), bool)
    mask[10:2900, 5:3990] = True
    runs = masks.run_lengths(masks.encode(mask))
    assert runs[0] == 5 * 3000 + 10
    assert set(runs[1:-1]) == {2890, 110}
    assert runs.sum() == mask.size


@given(npst.arrays(bool, st.tuples(st.just(2), st.integers(1, 20), st.integers(1, 20))))
def test_measures_agree_with_pixels(pair):
    first, second = pair
    a, b = masks.encode(first), masks.encode(second)
    assert masks.area(a) == first.sum()
    assert masks.intersection(a, b) == (first & second).sum()
    assert masks.union(a, b) == (first | second).sum()
    assert np.array_equal(masks.decode(masks.merge([a, b])), first | second)
    total = (first | second).sum()
    assert masks.iou(a, b) == (((first & second).sum() / total) if total else 0)


def test_bbox_is_x_y_width_height():
    mask = np.zeros((6, 9), bool)
    mask[1:3, 4:8] = True
    assert masks.bbox(masks.encode(mask)) == (4, 1, 4, 2)
    assert masks.bbox(masks.encode(np.zeros((6, 9), bool))) == (0, 0, 0, 0)


def test_combining_needs_one_size():
    a, b = masks.encode(np.ones((2, 3), bool)), masks.encode(np.ones((3, 2), bool))
    with pytest.raises(ValueError, match="differ in size"):
        masks.iou(a, b)


@settings(max_examples=200)
@given(st.integers(1, 4000), st.integers(1, 2000))
def test_nearest_indices_are_those_of_torch(size_in, size_out):
    line = torch.arange(size_in, dtype=torch.float32)[None, None]
    expected = torch.nn.functional.interpolate(line, size=size_out, mode="nearest")[0, 0]
    assert np.array_equal(masks.nearest_indices(size_in, size_out), expected.numpy().astype(int))


def test_single_precision_differs_from_integer_arithmetic():
    """Sizes where the published resize and exact arithmetic part: the reason for float32."""
    size_in, size_out = _first_disagreement()
    exact = np.arange(size_out) * size_in // size_out
    ours = masks.nearest_indices(size_in, size_out)
    assert not np.array_equal(ours, exact)
    assert np.abs(ours - exact).max() == 1


def _first_disagreement() -> tuple[int, int]:
    for size_in in range(1000, 4000):
        for size_out in (1023, 1000, 820):
            exact = np.arange(size_out) * size_in // size_out
            if not np.array_equal(masks.nearest_indices(size_in, size_out), exact):
                return size_in, size_out
    raise AssertionError("single precision never differed")


def test_resize_takes_the_upper_left_source_pixel():
    mask = np.array([[1, 0, 0, 0], [0, 0, 0, 1]], bool)
    small = masks.resize(masks.encode(mask), 1, 2)
    assert masks.decode(small).tolist() == [[True, False]]
    assert masks.resize(small, 1, 2) is small


def test_a_single_pixel_can_vanish():
    mask = np.zeros((4, 4), bool)
    mask[1, 1] = True
    assert masks.area(masks.resize(masks.encode(mask), 2, 2)) == 0


@pytest.mark.parametrize(
    ("size", "counts", "message"),
    [
        ([4, 5], "", "cannot be decoded"),
        ([4, 5], "P", "cannot be decoded"),
        ([4, 5], "zzzzzzzzzz0", "cannot be decoded"),
        ([4, 5], "é", "cannot be decoded"),
        ([4, 5], "oooooooooooooooooooo0", "cannot be decoded"),
        ([4, 5], "5", "do not fill"),
        ([4, 5], "O", "do not fill"),
        ([4, 5], [20], "compressed run-length"),
        ([4, 5], None, "compressed run-length"),
        ([4], "5", "height, width"),
        ([4.0, 5.0], "5", "height, width"),
        ([True, 5], "5", "height, width"),
        ("45", "5", "height, width"),
        ([0, 5], "0", "not plausible"),
        ([-4, 5], "0", "not plausible"),
        ([100_000, 1], "0", "not plausible"),
        ([16_000, 16_000], "0", "not plausible"),
    ],
)
def test_damaged_masks_are_refused(size, counts, message):
    with pytest.raises(InputError, match=message) as error:
        masks.verified(size, counts, "segments.json, object 3")
    assert str(error.value).startswith("segments.json, object 3: ")


def test_counts_may_be_bytes():
    rle = masks.encode(np.eye(3, dtype=bool))
    assert masks.verified((3, 3), rle.counts.encode(), "here") == Rle((3, 3), rle.counts)


@settings(max_examples=300)
@given(st.text(st.characters(min_codepoint=40, max_codepoint=120), max_size=12))
def test_any_text_is_a_mask_or_a_clear_error(counts):
    try:
        rle = masks.verified([4, 5], counts, "here")
    except InputError:
        return
    assert masks.run_lengths(rle).sum() == 20
    assert masks.area(rle) <= 20
