"""Every benchmark behind the protocol: its folders, their faults, and its scores."""

import json
import pickle
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from data_tools.benchmarks.benchmark import Benchmark, BenchmarkPair
from data_tools.benchmarks.box_ap import ScoredBox, box_ranking_in_picture
from data_tools.benchmarks.named import KINDS, open_benchmark
from data_tools.benchmarks.symmetric import carried, working_mask
from data_tools.benchmarks.validate import main
from scenediff_classic import masks
from scenediff_classic.cameras import project, unproject
from scenediff_classic.dataset import PredictedObject, PredictedView, Prediction, write_annotations
from scenediff_classic.dataset.export import write_object_masks
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.average_precision import average_precision
from scenediff_classic.types import Geometry, Kind, SparsePoints, Video, View
from scenediff_classic.video import read_capture
from tests.benchmarks import layouts
from tests.benchmarks.cards_on_disk import write_cards
from tests.benchmarks.layouts import block, rle
from tests.evaluation.scenes import box, prediction, truth
from tests.films import number_in, write_film
from tests.plane_scene import BOOK, BOOK_ELSEWHERE, CLOCK, VASE, scene

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
    removed = {"before": {0: rle(block(5, 5, 20, 20))}}
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


# Symmetric change


def _cards() -> tuple[Geometry, View, View]:
    """Vase before, clock after, a moved book; the first view of each capture."""
    geometry = scene([VASE, BOOK], [BOOK_ELSEWHERE, CLOCK])
    return geometry, geometry.of("before")[0], geometry.of("after")[0]


def _patch(view: View) -> np.ndarray:
    high, wide = view.shape
    return block(wide // 3, high // 3, wide // 4, high // 4, view.shape)


def _object(kind: Kind, video: Video, mask: np.ndarray, confidence: float = 0.9) -> PredictedObject:
    return PredictedObject(0, kind, (PredictedView(video, 0, confidence, rle(mask)),))


def _one_view_each() -> tuple[Geometry, View, View]:
    geometry, source, target = _cards()
    return Geometry((source, target), SparsePoints.none()), source, target


def test_marks_are_carried_where_depth_and_cameras_say() -> None:
    _, source, target = _one_view_each()
    marks = _patch(source)
    assert np.array_equal(working_mask(marks, source), marks)
    found = carried({0: marks}, (source,), target)
    xy, z = project(
        unproject(source)[marks].astype(float), target.intrinsics, target.cam_from_world
    )
    column, row = np.floor(xy).astype(int).T
    on = (column >= 0) & (column < found.shape[1]) & (row >= 0) & (row < found.shape[0])
    column, row, z = column[on], row[on], z[on]
    shown = z <= 1.05 * target.depth[row, column]
    assert shown.any()
    assert found[row[shown], column[shown]].all()
    itself = carried({0: marks}, (source,), source)
    assert masks.iou(rle(itself), rle(marks)) > 0.95


@pytest.fixture
def paslcd(tmp_path: Path) -> Iterator[tuple[Path, Geometry, View, View]]:
    geometry, source, target = _one_view_each()
    for instance in ("Instance_1", "Instance_2"):
        folder = tmp_path / "Pots" / instance
        layouts.picture(folder / "input_orig" / "a.png", size=source.shape)
        layouts.picture(folder / "input_orig_test" / "b.png", size=target.shape)
        expected = carried({0: _patch(source)}, (source,), target) | _patch(target)
        layouts.mask_picture(folder / "gt_mask" / "b.png", expected)
    yield tmp_path, geometry, source, target


def test_paslcd_asks_for_the_union_of_both_captures(paslcd, tmp_path: Path, capsys) -> None:
    root, geometry, source, target = paslcd
    benchmark = open_benchmark("paslcd", root)
    first, second = benchmark.pairs()
    assert [p.name for p in (first, second)] == ["Pots_Instance_1", "Pots_Instance_2"]
    assert [p.group for p in (first, second)] == ["similar light", "different light"]
    objects = (
        _object("removed", "before", _patch(source)),
        _object("added", "after", _patch(target)),
    )
    run = layouts.answer(tmp_path / "run", Prediction(objects), ("b.png",), target.shape, geometry)
    figures = benchmark.pool([benchmark.judge(first, run), benchmark.judge(second, None)])
    assert figures == {"miou": 0.5, "miou_similar": 1.0, "miou_different": 0.0}
    own = np.zeros(target.shape, bool)  # a method's own masks come first
    layouts.mask_picture(run / "symmetric" / "after_0000.png", own)
    assert benchmark.pool([benchmark.judge(first, run)])["miou"] == 0
    assert main(["paslcd", str(root)]) == 0
    capsys.readouterr()
    (root / "Pots" / "Instance_2" / "gt_mask" / "b.png").rename(
        root / "Pots/Instance_2/gt_mask/c.png"
    )
    (root / "Pots" / "Instance_1" / "input_orig" / "a.png").write_bytes(b"none")
    assert main(["paslcd", str(root)]) == 1
    printed = capsys.readouterr().out
    for fault in ("c.png belongs to no picture", "b.png has no mask", "a.png cannot be read"):
        assert fault in printed


def test_changesim_counts_pixels_of_all_pictures_together(tmp_path: Path, capsys) -> None:
    geometry, source, target = _one_view_each()
    expected = carried({0: _patch(source)}, (source,), target) | _patch(target)
    for name in ("Seq_0", "Seq_0_dark"):
        folder = tmp_path / "Query_Seq_Test" / "Warehouse_6" / name
        layouts.picture(folder / "rgb" / "0.png", size=target.shape)
        layouts.picture(folder / "t0" / "rgb" / "0.png", size=source.shape)
        layouts.mask_picture(folder / "change_segmentation" / "0.png", expected)
    benchmark = open_benchmark("changesim", tmp_path)
    (pair,) = benchmark.pairs()
    assert (pair.name, pair.group) == ("Warehouse_6_Seq_0_0", "Warehouse_6")
    assert len(open_benchmark("changesim", tmp_path, condition="dark", every="2").pairs()) == 1
    objects = (
        _object("removed", "before", _patch(source)),
        _object("added", "after", _patch(target)),
    )
    run = layouts.answer(tmp_path / "run", Prediction(objects), ("0.png",), target.shape, geometry)
    right, missed = benchmark.judge(pair, run), benchmark.judge(pair, None)
    assert benchmark.pool([right]) == {"f1": 1.0}
    assert benchmark.pool([right, missed])["f1"] == pytest.approx(2 / 3)
    assert main(["changesim", str(tmp_path)]) == 0
    (tmp_path / "Query_Seq_Test/Warehouse_6/Seq_0/t0/rgb/0.png").unlink()
    assert main(["changesim", str(tmp_path)]) == 1
    assert "0.png is missing" in capsys.readouterr().out


def test_rc3d_carries_a_box_into_the_view_that_lacks_the_thing(tmp_path: Path, capsys) -> None:
    geometry, source, target = _one_view_each()
    part = tmp_path / "part1"
    names = ("s_0.png", "s_1.png", "s_2.png")
    for name, view in zip(names, (source, source, target), strict=True):
        layouts.picture(part / name, size=view.shape)
        layouts.picture(part / f"depth_{Path(name).stem}.png")
    marks = _patch(source)
    place = unproject(source)[marks].astype(float)
    xy, _ = project(place, target.intrinsics, target.cam_from_world)
    low, high = xy.min(axis=0), xy.max(axis=0)
    notes = [
        {"image_id": 0, "bbox": list(masks.bbox(rle(marks)))},
        {"image_id": 2, "bbox": [*low.tolist(), *(high - low).tolist()]},
    ]
    content = {"images": [{"id": i, "file_name": n} for i, n in enumerate(names)]}
    (part / "coco_annotations.json").write_text(json.dumps({**content, "annotations": notes}))
    benchmark = open_benchmark("rc3d", tmp_path)
    (pair,) = benchmark.pairs()
    assert (pair.name, pair.after.path.name) == ("part1_s_0", "s_2.png")
    reported = Prediction((_object("removed", "before", marks),))
    run = layouts.answer(tmp_path / "run", reported, ("s_2.png",), target.shape, geometry)
    assert benchmark.pool([benchmark.judge(pair, run)]) == {"both": 1, "present": 1, "absent": 1}
    bare = layouts.answer(tmp_path / "bare", reported, ("s_2.png",), target.shape)
    assert benchmark.pool([benchmark.judge(pair, bare)]) == {"both": 0.5, "present": 1, "absent": 0}
    assert benchmark.pool([benchmark.judge(pair, None)])["both"] == 0
    assert main(["rc3d", str(tmp_path), "protocol=filtered", "convention=wide"]) == 0
    (part / "depth_s_2.png").unlink()
    assert main(["rc3d", str(tmp_path)]) == 1
    assert "depth_s_2.png is missing" in capsys.readouterr().out


def test_box_protocols() -> None:
    def precision(found: list[ScoredBox], protocol="raw", convention="half-open") -> float:
        ranking = box_ranking_in_picture(
            found, [(10, 10, 10, 10)], (224, 224), protocol, convention
        )
        return average_precision(ranking)

    exact, again = ScoredBox((10, 10, 10, 10), 0.5), ScoredBox((10, 10, 10, 11), 0.9)
    assert precision([exact, again]) == 1  # the surest one counts, the other is wrong after it
    assert precision([exact], "filtered") == 0  # 100 square pixels are too few
    narrow = ScoredBox((10, 10, 10, 4.9), 1.0)  # IoU 0.49; with a pixel around it 82.8 / 144
    assert precision([narrow]) == 0
    assert precision([narrow], convention="wide") == 1


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
