"""Folders of truths and predictions, in both modes, and what is said of them."""

import json
import os
import pickle
from dataclasses import replace

import pytest
from rich.console import Console

from scenediff_classic.dataset import Prediction, write_annotations, write_object_masks
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation import evaluate, pair_table, summary_table, to_json
from tests.evaluation.scenes import box, prediction, truth

A, B = box(0, 0, 100, 100), box(500, 500, 100, 100)
TRUTH = truth({"before": {0: A}}, {"after": {1: B}})
RIGHT = prediction((0.9, {"before": {0: A}}), (0.8, {"after": {1: B}}))
HALF = prediction((0.7, {"before": {0: A}}))


@pytest.fixture
def roots(tmp_path):
    """Three annotated pairs: predicted rightly, predicted by half, not predicted."""
    predictions, truths = tmp_path / "predictions", tmp_path / "truths"
    for name in ("a", "b", "c"):
        write_annotations(TRUTH, truths / name)
    write_object_masks(RIGHT, predictions / "a" / "object_masks.pkl")
    write_object_masks(HALF, predictions / "b" / "object_masks.pkl")
    return predictions, truths


def test_strict_counts_the_missing_pair(roots):
    result = evaluate(*roots)
    assert result.mode == "strict"
    assert [row.pair for row in result.pairs] == ["a", "b", "c"]
    assert [row.metrics.obj_sc_ap for row in result.pairs] == [1, 0.5, 0]
    assert result.metrics.px_im_iou == 0.5
    assert result.metrics.obj_im_ap == result.metrics.obj_sc_ap == 0.5
    assert (result.metrics.true_objects, result.metrics.found_objects) == (6, 3)
    assert "neither changes.json nor object_masks.pkl" in result.pairs[2].problem
    assert result.warnings == (
        "Pairs without a readable prediction and truth: 1 of 3, counted as all missed.",
    )


def test_official_leaves_the_missing_pair_out(roots):
    result = evaluate(*roots, "official")
    assert result.pairs[2].metrics is None
    assert result.metrics.px_im_iou == result.metrics.obj_sc_ap == 0.75
    assert result.metrics.true_objects == 4
    assert result.warnings == ("Pairs without a readable prediction and truth: 1 of 3, left out.",)


@pytest.mark.parametrize("mode", ["strict", "official"])
def test_unreadable_prediction_is_named(roots, mode):
    class Attack:
        def __reduce__(self):
            return os.system, ("exit 1",)

    predictions, truths = roots
    (predictions / "c").mkdir()
    path = predictions / "c" / "object_masks.pkl"
    path.write_bytes(pickle.dumps(Attack()))
    row = evaluate(predictions, truths, mode).pairs[2]
    assert row.problem.startswith(f"{path} was refused")
    assert (row.metrics is None) == (mode == "official")


def test_unreadable_truth(roots):
    predictions, truths = roots
    (truths / "a" / "segments.json").write_text("{")
    with pytest.raises(InputError, match="not valid JSON"):
        evaluate(predictions, truths, "strict")
    assert evaluate(predictions, truths, "official").metrics.obj_sc_ap == 0.5


def test_changes_json_scores_as_its_export(roots):
    predictions, truths = roots
    before = evaluate(predictions, truths).metrics
    for name, found in (("a", RIGHT), ("b", HALF)):
        (predictions / name / "object_masks.pkl").unlink()
        views = [
            [
                {
                    "video": view.video,
                    "frame": view.frame,
                    "confidence": view.confidence,
                    "rle": {"size": view.mask.size, "counts": view.mask.counts},
                }
                for view in item.views
            ]
            for item in found.objects
        ]
        objects = [
            {"id": item.id, "kind": item.kind, "views": views[i]}
            for i, item in enumerate(found.objects)
        ]
        text = json.dumps({"schema": 1, "objects": objects})
        (predictions / name / "changes.json").write_text(text)
    assert evaluate(predictions, truths).metrics == before


def test_nothing_to_find_and_nothing_reported(tmp_path):
    write_annotations(truth(), tmp_path / "truths" / "quiet")
    write_object_masks(Prediction(()), tmp_path / "predictions" / "quiet" / "object_masks.pkl")
    roots = tmp_path / "predictions", tmp_path / "truths"
    strict, official = evaluate(*roots).metrics, evaluate(*roots, "official").metrics
    assert (strict.px_im_iou, strict.obj_im_ap, strict.obj_sc_ap) == (None, None, None)
    assert (official.px_im_iou, official.obj_im_ap, official.obj_sc_ap) == (0, 0, 0)


def test_false_alarm_where_nothing_changed(tmp_path):
    write_annotations(truth(), tmp_path / "truths" / "quiet")
    write_object_masks(HALF, tmp_path / "predictions" / "quiet" / "object_masks.pkl")
    metrics = evaluate(tmp_path / "predictions", tmp_path / "truths").metrics
    assert (metrics.px_im_iou, metrics.obj_im_ap, metrics.obj_sc_ap) == (0, 0, 0)
    assert metrics.reported_objects == 1


@pytest.fixture
def benchmark(roots):
    predictions, truths = roots
    root = truths.parent / "benchmark"
    (root / "splits").mkdir(parents=True)
    truths.rename(root / "data")
    splits = {
        "val": {"varied": ["c"], "kitchen": ["lost"]},
        "test": {"varied": [], "kitchen": ["a"]},
    }
    for name, content in splits.items():
        (root / "splits" / f"{name}_split.json").write_text(json.dumps(content))
    return predictions, root


def test_split_files_give_the_order(benchmark):
    result = evaluate(*benchmark)
    assert [row.pair for row in result.pairs] == ["c", "a", "b"]
    assert result.warnings[0].startswith("Pairs of the split files without a truth")


def test_one_split_or_subset(benchmark):
    assert [r.pair for r in evaluate(*benchmark, split="test").pairs] == ["a"]
    assert [r.pair for r in evaluate(*benchmark, subset="varied").pairs] == ["c"]
    with pytest.raises(InputError, match="holds no"):
        evaluate(*benchmark, split="test", subset="varied")


@pytest.mark.parametrize(
    ("text", "message"),
    [("{", "not a split file"), ('{"varied": []}', "not a split file"), ("[]", "not a split file"),
     ('{"varied": [1], "kitchen": []}', "not a pair's name")],
)  # fmt: skip
def test_damaged_split_file(benchmark, text, message):
    (benchmark[1] / "splits" / "val_split.json").write_text(text)
    with pytest.raises(InputError, match=message):
        evaluate(*benchmark)


def test_a_split_file_cannot_lead_out_of_the_benchmark(benchmark):
    predictions, root = benchmark
    write_annotations(TRUTH, root.parent / "outside")
    names = ["../outside", str(root.parent / "outside"), "a"]
    text = json.dumps({"varied": names, "kitchen": []})
    (root / "splits" / "val_split.json").write_text(text)
    assert [row.pair for row in evaluate(predictions, root, split="val").pairs] == ["a"]


def test_bad_requests(roots, tmp_path):
    predictions, truths = roots
    with pytest.raises(InputError, match="not a folder: give the folder that holds predictions"):
        evaluate(tmp_path / "absent", truths)
    with pytest.raises(InputError, match="not a folder: give the folder that holds the truth"):
        evaluate(predictions, tmp_path / "absent")
    with pytest.raises(InputError, match=r"holds no <pair>/segments\.json"):
        evaluate(predictions, predictions)
    with pytest.raises(InputError, match="no pair is known to be in 'val'"):
        evaluate(*roots, split="val")
    with pytest.raises(InputError, match="choose strict or official"):
        evaluate(*roots, "lenient")
    with pytest.raises(InputError, match="Strict mode counts every duplicate"):
        evaluate(*roots, object_duplicates=2)
    with pytest.raises(InputError, match="at least 1"):
        evaluate(*roots, "official", region_duplicates=0)


def test_a_prediction_without_truth_is_mentioned(roots):
    predictions, truths = roots
    (predictions / "notes").mkdir()
    (predictions / "c").mkdir()
    write_object_masks(HALF, predictions / "C" / "object_masks.pkl")
    warning = "Predictions without a truth, not scored: 1, the first is 'C'."
    assert warning in evaluate(predictions, truths).warnings


def test_progress_reaches_its_end(roots):
    seen = []
    evaluate(*roots, progress=lambda stage, done, total: seen.append((stage, done, total)))
    assert seen == [("evaluate", k, 3) for k in range(4)]


def printed(table) -> str:
    console = Console(width=300, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    with console.file:
        console.print(table)
        return console.export_text()


def test_tables_name_their_mode_and_show_every_pair(roots):
    strict, official = evaluate(*roots), evaluate(*roots, "official")
    assert "3 of 3 pairs, strict mode" in printed(summary_table(strict))
    assert "2 of 3 pairs, official mode" in printed(summary_table(official))
    text = printed(pair_table(strict))
    assert "50.0" in text
    assert "1 / 2" in text
    assert "holds neither" in text
    untroubled = replace(strict, pairs=strict.pairs[:2])
    assert "problem" not in printed(pair_table(untroubled))


def test_json_holds_the_whole_result(roots):
    result = evaluate(*roots, "official")
    content = json.loads(to_json(result))
    assert content["mode"] == "official"
    assert content["metrics"]["obj_sc_ap"] == 0.75
    assert content["metrics"]["pixels"] == {"hit": 30000, "false": 0, "missed": 10000}
    assert [row["pair"] for row in content["pairs"]] == ["a", "b", "c"]
    assert content["pairs"][2]["metrics"] is None
    assert content["warnings"] == list(result.warnings)
