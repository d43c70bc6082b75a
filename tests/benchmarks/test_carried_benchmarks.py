"""Benchmarks that ask where a change lies in the other capture: PASLCD, ChangeSim, RC-3D."""

import json
from pathlib import Path

import numpy as np
import pytest

from data_tools.benchmarks.box_ap import Convention, Protocol, ScoredBox, box_ranking_in_picture
from data_tools.benchmarks.named import open_benchmark
from data_tools.benchmarks.symmetric import carried, working_mask
from data_tools.benchmarks.validate import main
from scenediff_classic import masks
from scenediff_classic.cameras import project, unproject
from scenediff_classic.dataset import PredictedObject, PredictedView, Prediction
from scenediff_classic.evaluation.average_precision import average_precision
from scenediff_classic.types import Geometry, Kind, SparsePoints, Video, View
from tests.benchmarks import layouts
from tests.benchmarks.layouts import block, rle
from tests.plane_scene import BOOK, BOOK_ELSEWHERE, CLOCK, VASE, scene


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
    _geometry, source, target = _cards()
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
def paslcd(tmp_path: Path) -> tuple[Path, Geometry, View, View]:
    geometry, source, target = _one_view_each()
    for instance in ("Instance_1", "Instance_2"):
        folder = tmp_path / "Pots" / instance
        layouts.picture(folder / "input_orig" / "a.png", size=source.shape)
        layouts.picture(folder / "input_orig_test" / "b.png", size=target.shape)
        expected = carried({0: _patch(source)}, (source,), target) | _patch(target)
        layouts.mask_picture(folder / "gt_mask" / "b.png", expected)
    return tmp_path, geometry, source, target


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
    def precision(
        found: list[ScoredBox],
        protocol: Protocol = "raw",
        convention: Convention = "half-open",
    ) -> float:
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
