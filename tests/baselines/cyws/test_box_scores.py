"""Boxes of whole captures judged by themselves, with the partner that each has."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from baselines.cyws.box_scores import BoxScores, Shape, compared, ranking
from baselines.cyws.decoder import HeadMaps
from baselines.cyws.presets import Preset
from baselines.cyws.raw_boxes import NAME, RawBox, Spot, boxes_text, read_boxes, source_box
from baselines.cyws.registration import Registration
from baselines.cyws.view_boxes import view_boxes
from scenediff_classic.dataset import (
    AnnotatedMask,
    AnnotatedObject,
    AnnotatedPair,
    Track,
    write_annotations,
)
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.average_precision import Ranking, average_precision
from scenediff_classic.evaluation.rules import Mode, rules_of
from scenediff_classic.masks import encode
from scenediff_classic.types import Geometry, Lens, SparsePoints, Video, View


def _spot(video: Video, x: int, y: int, wide: int = 10, high: int = 10, frame: int = 0) -> Spot:
    mask = np.zeros((40, 60), bool)
    mask[y : y + high, x : x + wide] = True
    return Spot(video, frame, (float(x), float(y), float(wide), float(high)), encode(mask))


def _truth() -> AnnotatedPair:
    """A thing of 10 x 10 pixels in before, at (5, 5), that is gone in after."""
    gone = Track("before", 1, (AnnotatedMask(0, _spot("before", 5, 5).mask),))
    return AnnotatedPair("synthetic", (gone,), (AnnotatedObject(1, "mug_1", True, False),))


def _judged(
    boxes: list[RawBox],
    shape: Shape,
    mode: Mode = "strict",
    *,
    ignore: bool = False,
    truth: AnnotatedPair | None = None,
) -> Ranking:
    rules = rules_of(mode)
    return ranking(compared(truth or _truth(), boxes, shape, rules), rules, ignore)


RIGHT = RawBox(_spot("before", 6, 5), 0.6, None)
WHERE_IT_LACKS = RawBox(_spot("after", 30, 20), 0.9, _spot("before", 5, 6))
WRONG = RawBox(_spot("after", 40, 20), 0.8, _spot("before", 30, 6))
ALONE = RawBox(_spot("after", 10, 0), 0.7, None)


@pytest.mark.parametrize("shape", ["box", "mask"])
@pytest.mark.parametrize("mode", ["strict", "official"])
def test_a_false_box_is_ignored_for_a_right_partner_alone(shape: Shape, mode: Mode) -> None:
    boxes = [RIGHT, WHERE_IT_LACKS, WRONG, ALONE]
    plain = _judged(boxes, shape, mode, ignore=False)
    assert plain.confidence.tolist() == [0.9, 0.8, 0.7, 0.6]
    assert plain.hit.tolist() == [False, False, False, True]
    assert plain.positives == 1
    kind = _judged(boxes, shape, mode, ignore=True)
    assert kind.confidence.tolist() == [0.8, 0.7, 0.6]
    assert (average_precision(plain), average_precision(kind)) == pytest.approx((1 / 4, 1 / 3))


def test_a_right_box_counts_whatever_its_partner() -> None:
    also = replace(RIGHT, partner=_spot("after", 0, 0))
    judged = _judged([also], "box", ignore=True)
    assert judged.hit.tolist() == [True]


def test_box_and_mask_are_judged_apart() -> None:
    half = _spot("before", 5, 5, 10, 4)  # a mask of less than half of a right box
    item = RawBox(Spot("before", 0, (5, 5, 10, 10), half.mask), 0.5, None)
    assert _judged([item], "box").hit.tolist() == [True]
    assert _judged([item], "mask").hit.tolist() == [False]
    other_frame = RawBox(_spot("before", 5, 5, frame=1), 0.5, None)
    assert _judged([other_frame], "box").hit.tolist() == [False]


def test_truth_of_another_size_is_the_same_truth() -> None:
    mask = np.zeros((80, 120), bool)
    mask[10:30, 10:30] = True
    gone = Track("before", 1, (AnnotatedMask(0, encode(mask)),))
    truth = replace(_truth(), tracks=(gone,))
    for shape in ("box", "mask"):
        judged = _judged([RIGHT], shape, truth=truth)
        assert judged.hit.tolist() == [True]


# --- the command --------------------------------------------------------------------------------


def _benchmark(root: Path) -> tuple[Path, Path]:
    for name in ("a", "b"):
        (root / "truth" / name).mkdir(parents=True)
        write_annotations(_truth(), root / "truth" / name)
    (root / "runs" / "a").mkdir(parents=True)
    text = boxes_text([RIGHT, WHERE_IT_LACKS])
    (root / "runs" / "a" / NAME).write_text(text, encoding="utf-8")
    return root / "runs", root / "truth"


def test_a_missing_pair_is_missed_or_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs, truth = _benchmark(tmp_path)
    rows = BoxScores(runs, truth, out=tmp_path / "figures.json")()
    assert [rows[n].ap50 for n in ("raw boxes", "raw boxes, ignore rule")] == [0.25, 0.5]
    assert (rows["raw boxes"].reported, rows["raw boxes, ignore rule"].reported) == (2, 1)
    assert "Pairs without boxes.json: 1, counted as all missed." in capsys.readouterr().out
    written = json.loads((tmp_path / "figures.json").read_text())
    assert written["masks of the boxes, ignore rule"]["truths"] == 2
    rows = BoxScores(runs, truth, "official")()
    assert [rows[n].ap50 for n in ("raw boxes", "raw boxes, ignore rule")] == [0.5, 1.0]


def test_runs_without_any_boxes_are_refused(tmp_path: Path) -> None:
    _, truth = _benchmark(tmp_path)
    with pytest.raises(InputError, match=r"holds no <pair>/boxes\.json"):
        BoxScores(truth, truth)()


def test_boxes_are_kept(tmp_path: Path) -> None:
    path = tmp_path / NAME
    path.write_text(boxes_text([RIGHT, WRONG]), encoding="utf-8")
    assert read_boxes(path) == (RIGHT, WRONG)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ('"schema": 1', '"schema": 2', "another version"),
        ('"video": "before"', '"video": "later"', "should be one of before, after"),
        ('"score": 0.6', '"score": NaN', "not valid JSON"),
        ('"partner": null', '"other": null', "'partner' is missing"),
        ("    5.0,\n", "", "four numbers"),
    ],
)
def test_damaged_boxes_are_refused(tmp_path: Path, old: str, new: str, why: str) -> None:
    text = boxes_text([RIGHT])
    assert old in text
    (tmp_path / NAME).write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=why):
        read_boxes(tmp_path / NAME)


# --- from views to boxes ------------------------------------------------------------------------


class _Seeing(torch.nn.Module):
    """Boxes one given cell in both pictures, a little surer in the first."""

    def forward(self, images: torch.Tensor, registration: Registration) -> HeadMaps:
        heat = torch.full((2, 1, 8, 8), -9.0)
        heat[0, 0, 3, 2], heat[1, 0, 3, 2] = 1.0, 0.0
        return HeadMaps(heat, torch.full((2, 2, 8, 8), 3.0), torch.full((2, 2, 8, 8), 0.5))


def _view(video: Video, height: int, width: int) -> View:
    lens = np.array([[width, 0, width / 2], [0, height, height / 2], [0, 0, 1.0]])
    flat = np.ones((height, width), np.float32)
    nothing = np.zeros((height, width), bool)
    return View(
        video, 0, video, np.zeros((height, width, 3), np.uint8), lens, np.eye(4), flat, flat,
        ~nothing, nothing, Lens(width, height, lens, np.zeros(4)),
    )  # fmt: skip


def test_boxes_know_their_partner_in_the_other_view() -> None:
    views = _view("before", 64, 64), _view("after", 32, 128)
    geometry = Geometry(views, SparsePoints.none())
    preset = Preset("cyws3d-small", 64, 64)
    (first,), (second,) = view_boxes(_Seeing(), preset, geometry, [(0, 1)])
    # cell (3, 2) of 8 x 8, three cells wide: 8 to 32 of 64 columns, 16 to 40 of 64 rows
    assert first.xyxy == pytest.approx((8, 16, 32, 40))
    assert second.xyxy == pytest.approx((16, 8, 64, 20))
    assert first.score > second.score
    assert first.partner is not None
    assert second.partner is not None
    assert (first.partner.view, first.partner.xyxy) == (1, second.xyxy)
    assert (second.partner.view, second.partner.xyxy) == (0, first.xyxy)
    twice = view_boxes(_Seeing(), preset, geometry, [(0, 1), (0, 1)])
    assert [len(found) for found in twice] == [1, 1]
    assert view_boxes(_Seeing(), preset, geometry, [(0, 1)], least=0.99) == [(), ()]


def test_boxes_follow_the_lens_and_stay_in_the_picture() -> None:
    view = _view("before", 40, 60)
    assert source_box((10, 5, 20, 25), view) == pytest.approx((10, 5, 10, 20))
    assert source_box((-5, 30, 20, 45), view) == pytest.approx((0, 30, 20, 10))
    twice = replace(view, lens=Lens(120, 80, view.intrinsics * [[2], [2], [1]], np.zeros(4)))
    assert source_box((10, 5, 20, 25), twice) == pytest.approx((20, 10, 20, 40))
    barrel = replace(view, lens=replace(view.lens, distortion=np.array([-0.2, 0, 0, 0])))
    x, y, wide, high = source_box((0, 0, 60, 40), barrel)
    # the middles of the edges lie farther out than the corners do
    assert (x, y) == pytest.approx((30 - 60 * 0.5 * 0.95, 20 - 40 * 0.5 * 0.95))
    assert (wide, high) == pytest.approx((57, 38))
