"""Hand-drawn boxes against predicted ones, worked out by hand."""

import json
from dataclasses import replace

import numpy as np
import pytest

from data_tools.benchmarks.hand_boxes import HandBox, box_iou, read_hand_boxes, score_boxes
from scenediff_classic.errors import InputError
from scenediff_classic.masks import encode
from scenediff_classic.types import (
    ChangedObject,
    ChangeResult,
    FrameInfo,
    ObjectView,
    TermScores,
    VideoInfo,
)


def result(*boxes: tuple[float, float, float, float]) -> ChangeResult:
    """One added object per box, all in after frame 0 ("a.jpg")."""
    mask = encode(np.ones((2, 2), bool))
    objects = tuple(
        ChangedObject(
            k + 1, "added", 0.5, None, (0.0, 0.0, 0.0), None, (1.0, 1.0, 1.0),
            TermScores(0, 0, 0), (ObjectView("after", 0, 0.5, box, mask),),
        )
        for k, box in enumerate(boxes)
    )  # fmt: skip
    frame = FrameInfo(0, "a.jpg", None, 100, 100, True, None)
    before = VideoInfo("before", (replace(frame, name="b.jpg"),))
    return ChangeResult(before, VideoInfo("after", (frame,)), objects, 0.1, 1.0)


def test_box_iou():
    assert box_iou((0, 0, 10, 10), (0, 0, 10, 10)) == 1
    assert box_iou((0, 0, 10, 10), (5, 0, 10, 10)) == pytest.approx(1 / 3)
    assert box_iou((0, 0, 10, 10), (10, 0, 10, 10)) == 0


def test_found_and_spurious():
    truth = (
        HandBox("1", "after", "a.jpg", (0, 0, 10, 10)),
        HandBox("2", "after", "a.jpg", (50, 50, 10, 10)),
        HandBox("3", "after", "elsewhere.jpg", (80, 80, 10, 10)),
    )
    score = score_boxes(result((0, 0, 10, 9), (80, 80, 10, 10)), truth)
    assert score.found == {"1": pytest.approx(0.9), "2": 0, "3": 0}
    assert score.spurious == (2,)


def test_both_kinds_of_file(tmp_path):
    sheet = {
        "after_images": [
            {"file": "after/a.jpg", "boxes": [{"change": 4, "bbox_xyxy": [1, 2, 11, 22]}]}
        ]
    }
    visit = {"boxes": [{"name": "mug", "video": "after", "frame": 0, "box": [1, 2, 11, 22]}]}
    expected = {"4": sheet, "mug": visit}
    for change, content in expected.items():
        path = tmp_path / f"{change}.json"
        path.write_text(json.dumps(content))
        (item,) = read_hand_boxes(path, result())
        assert item == HandBox(change, "after", "a.jpg", (1, 2, 10, 20))


@pytest.mark.parametrize("content", ["", "{}", '{"boxes": [{"name": "x"}]}', "[]"])
def test_other_files_are_refused(tmp_path, content):
    path = tmp_path / "boxes.json"
    path.write_text(content)
    with pytest.raises(InputError, match="no hand-drawn boxes"):
        read_hand_boxes(path, result())
