"""Every benchmark behind the protocol: its folders, their faults, and its scores."""

import json
import pickle
from pathlib import Path

import pytest

from data_tools.benchmarks.benchmark import Benchmark, BenchmarkPair
from data_tools.benchmarks.named import KINDS, open_benchmark
from data_tools.benchmarks.validate import main
from scenediff_classic.dataset import write_annotations
from scenediff_classic.dataset.export import write_object_masks
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.errors import InputError
from scenediff_classic.video import read_capture
from tests.benchmarks import layouts
from tests.benchmarks.cards_on_disk import write_cards
from tests.benchmarks.layouts import block, rle
from tests.evaluation.scenes import Views, box, prediction, truth
from tests.films import number_in, write_film

TRUTH = truth(
    {"before": {0: rle(block(5, 5, 20, 20)), 1: rle(block(8, 5, 20, 20))}},
    {"before": {0: rle(block(30, 5, 20, 20))}, "after": {1: rle(block(30, 9, 20, 20))}},
)


class Attack:
    def __reduce__(self):
        return print, ("never run",)


def test_unknown_kinds_and_options_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="choose synthetic, scenediff"):
        open_benchmark("kitti", tmp_path)
    with pytest.raises(InputError, match="choose mode, split, subset"):
        open_benchmark("scenediff", tmp_path, speed=3)
    with pytest.raises(InputError, match="takes none"):
        open_benchmark("paslcd", tmp_path, mode="strict")
    with pytest.raises(InputError, match="strict or official"):
        open_benchmark("synthetic", tmp_path, mode="kind")
    with pytest.raises(InputError, match="not a folder"):
        open_benchmark("rc3d", tmp_path / "absent")


@pytest.mark.parametrize("kind", list(KINDS))
def test_an_empty_folder_is_a_problem_and_no_crash(kind: str, tmp_path: Path, capsys) -> None:
    assert isinstance(open_benchmark(kind, tmp_path), Benchmark)
    assert main([kind, str(tmp_path)]) == 1
    assert str(tmp_path) in capsys.readouterr().out


def test_rendered_pairs(tmp_path: Path, capsys) -> None:
    write_cards(tmp_path / "val" / "cards")
    folder = tmp_path / "val" / "cards"
    (folder / "metadata.json").write_text('{"hard": ["small"]}')
    benchmark = open_benchmark("synthetic", tmp_path / "val")
    (pair,) = benchmark.pairs()
    assert (pair.group, pair.known_geometry) == ("small", folder / "truth_geometry.npz")
    assert benchmark.problems() == ()
    assert benchmark.pool([benchmark.judge(pair, None)])["obj_sc_ap"] == 0
    assert main(["synthetic", str(tmp_path / "val")]) == 0
    assert "objects" in capsys.readouterr().out
    (folder / "after" / "0001.png").write_bytes(b"no picture")
    (folder / "metadata.json").write_text("{")
    found = "\n".join(benchmark.problems())
    assert "metadata.json is not valid JSON" in found
    assert "6 cameras for 5 pictures" in found


# The SceneDiff Benchmark


@pytest.mark.parametrize("rate", [10, 30, 60, 120])
def test_sampled_frames_carry_the_index_that_is_compared(rate: int, tmp_path: Path) -> None:
    """Annotation index 30 k is original frame round(30 k · rate / 30), whatever the frame rate."""
    times = [round(1000 * k / rate) for k in range(2 * rate + 1)]
    film = write_film(tmp_path / "original_video1.MOV", times)
    capture = read_capture(film, "before", fps=1.0)
    assert [number_in(f.image) for f in capture.frames] == [
        round(30 * f.index * rate / 30) for f in capture.frames
    ]
    assert [f.index for f in capture.frames] == [0, 1, 2]


def test_pairs_of_the_published_layout(tmp_path: Path, capsys) -> None:
    layouts.scenediff(tmp_path, TRUTH, ("one", "two"))
    benchmark = open_benchmark("scenediff", tmp_path)
    assert [(p.name, p.group) for p in benchmark.pairs()] == [("one", "varied"), ("two", "kitchen")]
    assert benchmark.pairs()[0].before.path.name == "original_video1.mp4"
    assert benchmark.pairs()[0].after.path.name == "original_video2.MOV"
    assert benchmark.problems() == ()
    kitchen = open_benchmark("scenediff", tmp_path, split="val", subset="kitchen")
    assert [p.name for p in kitchen.pairs()] == ["two"]
    assert main(["scenediff", str(tmp_path), "subset=kitchen"]) == 0
    assert "removed" in capsys.readouterr().out


def test_published_predictions_are_read_and_removed_only_pairs_count(tmp_path: Path) -> None:
    removed: Views = {"before": {0: rle(block(5, 5, 20, 20))}}
    layouts.scenediff(tmp_path, truth(removed))
    benchmark = open_benchmark("scenediff", tmp_path)
    (pair,) = benchmark.pairs()
    assert benchmark.problems() == ()
    write_object_masks(prediction((0.9, removed)), tmp_path / "object_masks.pkl")
    figures = benchmark.pool([benchmark.judge(pair, tmp_path)])
    assert figures == dict.fromkeys(benchmark.metrics, 1.0)


def test_every_fault_of_a_folder_is_named_at_once(tmp_path: Path, capsys) -> None:
    layouts.scenediff(tmp_path, TRUTH, ("one", "two", "three", "four"))
    layouts.split(tmp_path, varied=("one", "two", "absent", "one"), kitchen=("three", "four"))
    data = tmp_path / "data"
    (data / "one" / "original_video1.mp4").unlink()
    (data / "two" / "original_video2.MOV").write_bytes(b"no film at all")
    (data / "three" / "segments.json").write_text("{")
    odd = truth({"before": {0: box(0, 0, 9, 9, (24, 24))}}, {"after": {}})
    write_annotations(odd, data / "four")
    assert main(["scenediff", str(tmp_path)]) == 1
    printed = capsys.readouterr().out
    for fault in (
        "'absent' under varied, but",
        "'one' under varied, which is listed before",
        "one holds no original_video1.mp4",
        "original_video2.MOV is neither",
        "segments.json is not valid JSON",
        "24x24 pixels at frame 0, where the picture has 64x48",
        "object 1 'thing_1' is flagged in after and has no mask there",
        "7 problems",
    ):
        assert fault in printed


def test_a_malicious_pickle_is_refused(tmp_path: Path, capsys) -> None:
    layouts.scenediff(tmp_path, TRUTH)
    benchmark = open_benchmark("scenediff", tmp_path)
    run = tmp_path / "run"
    run.mkdir()
    (run / "object_masks.pkl").write_bytes(pickle.dumps({1: Attack()}))
    with pytest.raises(InputError, match=r"was refused: it asks for builtins\.print"):
        benchmark.judge(benchmark.pairs()[0], run)
    folder = tmp_path / "data" / "one"
    (folder / "segments.json").unlink()
    (folder / "segments.pkl").write_bytes(pickle.dumps(Attack()))
    assert main(["scenediff", str(tmp_path)]) == 1
    printed = capsys.readouterr().out
    assert "was refused" in printed
    assert "never run" not in printed


def test_golden_cases_through_the_protocol(tmp_path: Path) -> None:
    """Provenance: as in tests/evaluation/test_golden.py, outputs of the published evaluator."""
    a, b = box(0, 0, 100, 100), box(500, 500, 100, 100)
    small = box(1001, 1001, 1, 1, (2048, 2048))
    large = box(0, 0, 200, 200, (2048, 2048))
    half = box(0, 0, 100, 50)
    cases = [
        (
            truth({"before": {0: a}, "after": {0: b}}),
            prediction((0.9, {"before": {0: a}}), (0.8, {"after": {0: b}})),
            {"obj_im_ap": 1, "obj_sc_ap": 0},
        ),
        (
            truth({"before": {0: a}}),
            prediction((1.0, {"before": {0: half}})),
            {"obj_im_ap": 0, "obj_sc_ap": 0},
        ),
        (
            truth({"before": {0: a}}, {"before": {}}),
            prediction((1.0, {"before": {0: a}})),
            {"obj_im_ap": 1, "obj_sc_ap": 0.5},
        ),
        (
            truth({"before": {0: large}}, {"before": {0: small}}),
            prediction((1.0, {"before": {0: large}})),
            {"obj_im_ap": 0.5, "obj_sc_ap": 0.5},
        ),
        (
            truth({"before": {0: a}}),
            prediction((1.0, {"before": {0: a}, "after": {}})),
            {"obj_sc_ap": 1, "obj_sc_ap_typed": 0},
        ),
    ]
    for number, (true, reported, expected) in enumerate(cases):
        folder = tmp_path / str(number) / "data" / "pair"
        folder.mkdir(parents=True)
        write_annotations(true, folder)
        write_object_masks(reported, tmp_path / str(number) / "object_masks.pkl")
        benchmark = open_benchmark("scenediff", tmp_path / str(number), mode="official")
        (pair,) = benchmark.pairs()
        figures = benchmark.pool([benchmark.judge(pair, tmp_path / str(number))])
        assert {key: figures[key] for key in expected} == expected
        assert benchmark.judge(pair, None) is None  # official mode leaves the pair out
        assert open_benchmark("scenediff", tmp_path / str(number)).judge(pair, None) is not None


def test_obchange_pairs(real_data: Path, tmp_path: Path) -> None:
    benchmark = open_benchmark("obchange", real_data / "obchange_gh30", work=str(tmp_path))
    for name in ("changed", "unchanged"):
        (tmp_path / name).mkdir()
    boxes = {"name": "cup", "kind": "added", "video": "after", "frame": 0, "box": [1, 1, 9, 9]}
    (tmp_path / "changed" / "boxes.json").write_text(json.dumps({"boxes": [boxes]}))
    (tmp_path / "unchanged" / "boxes.json").write_text(json.dumps({"boxes": []}))
    nowhere = CaptureOptions(tmp_path)
    changed, unchanged = (
        BenchmarkPair(name, nowhere, nowhere, truth=tmp_path / name / "boxes.json")
        for name in ("changed", "unchanged")
    )
    failed = benchmark.pool([benchmark.judge(p, None) for p in (changed, unchanged)])
    assert failed == {"box_ap50": 0.0, "found": 0.0, "right": None, "quiet": 0.0}
    assert benchmark.problems() == ()
