"""Exports, read back by our own reader, by the pickle module and by COCO's tools."""

import contextlib
import io
import json
import pickle

import numpy as np
import pytest
from pycocotools.coco import COCO

from scenediff_classic import masks
from scenediff_classic.dataset import Prediction, export, read_prediction, write_object_masks
from scenediff_classic.errors import InputError, OutputError
from tests.dataset.test_predictions import changes, item, view


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    content = changes(
        item("moved", [view(confidence=0.25), view("after", 2)], 4),
        item("removed", [view()], 5),
        item("added", [], 6),
    )
    after = {"index": 2, "name": "b#2", "width": 8, "height": 6}
    content["videos"]["after"]["frames"] = [after]
    (folder / "changes.json").write_text(json.dumps(content))
    return folder


def test_published_layout_says_the_same(run):
    path = export(run, "scenediff")
    assert path == run / "object_masks.pkl"
    original, exported = read_prediction(run / "changes.json"), read_prediction(path)
    assert exported.objects == original.objects
    assert exported.size == original.size == (6, 8)


def test_published_layout_in_detail(run):
    content = pickle.loads(export(run, "scenediff").read_bytes())
    mask = content[4]["video_1"][0]
    assert list(content) == ["H", "W", 4, 5, 6]
    assert (content["H"], content["W"]) == (6, 8)
    assert list(content[4]) == ["video_1", "video_2"]
    assert list(content[5]) == ["video_1"]
    assert content[6] == {"video_2": {}}
    assert list(content[4]["video_2"]) == [2]
    assert mask["mask_size"] == 6
    assert mask["cost"] == 0.25
    assert mask["mask"] == {
        "size": [6, 8],
        "counts": masks.encode(np.eye(6, 8) > 0).counts.encode(),
    }


def test_a_prediction_without_frames_states_no_size(tmp_path):
    write_object_masks(Prediction(()), tmp_path / "object_masks.pkl")
    assert read_prediction(tmp_path / "object_masks.pkl") == Prediction(())


def test_coco_tools_read_the_export(run, tmp_path):
    path = export(run, "coco", tmp_path / "changes.coco.json")
    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO(str(path))
    assert [c["name"] for c in coco.loadCats(coco.getCatIds())] == ["added", "removed", "moved"]
    assert [i["file_name"] for i in coco.loadImgs(coco.getImgIds())] == ["ä.jpg", "b#2"]
    moved = coco.loadAnns(coco.getAnnIds(catIds=coco.getCatIds(catNms=["moved"])))
    assert [(a["image_id"], a["object_id"], a["score"]) for a in moved] == [
        (1, 4, 0.25),
        (2, 4, 0.5),
    ]
    assert moved[0]["bbox"] == [0, 0, 6, 6]
    assert coco.annToRLE(moved[0])["size"] == [6, 8]
    assert moved[0]["area"] == 6


def test_destination_may_be_a_folder(run, tmp_path):
    assert export(run, "coco", tmp_path) == tmp_path / "coco.json"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["coco.json", "run"]


def test_a_mask_outside_the_runs_frames_is_refused(run):
    content = changes(item("added", [view("after", 7)]))
    (run / "changes.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="object 1 has a mask in after frame 7"):
        export(run, "coco")
    assert not (run / "coco.json").exists()


def test_bad_requests(run, tmp_path):
    with pytest.raises(InputError, match=r"holds no changes\.json"):
        export(tmp_path, "coco")
    with pytest.raises(InputError, match="choose scenediff or coco"):
        export(run, "yolo")  # pyright: ignore[reportArgumentType]
    with pytest.raises(OutputError, match="cannot be written"):
        export(run, "coco", run / "changes.json" / "coco.json")
