"""Scoring of boxes: every drawn box once, the surest box first; and the whole command, small."""

import json
from dataclasses import replace
from pathlib import Path

from data_tools.benchmarks.hand_boxes import HandBox
from data_tools.benchmarks.obchange_scores import ObChangeBenchmark, VisitPair, box_ranking
from scenediff_classic.evaluation.average_precision import average_precision
from scenediff_classic.types import ChangeResult
from tests.result.documents import one_object


def _truth(result: ChangeResult) -> list[HandBox]:
    names = {
        (video, frame.index): Path(frame.name).name
        for video, info in (("before", result.before), ("after", result.after))
        for frame in info.frames
    }
    return [
        HandBox(str(item.id), v.video, names[v.video, v.frame], v.bbox)
        for item in result.objects
        for v in item.views
    ]


def test_exact_boxes_are_all_found() -> None:
    result = one_object()
    ranking = box_ranking(result, _truth(result))
    assert ranking.hit.all()
    assert average_precision(ranking) == 1


def test_a_drawn_box_is_found_once_and_in_its_own_picture() -> None:
    result = one_object()
    truth = _truth(result)
    twice = replace(result, objects=(result.objects[0], *result.objects))
    ranking = box_ranking(twice, truth)
    assert ranking.hit.sum() == len(truth)
    assert not box_ranking(result, [replace(b, frame="elsewhere.png") for b in truth]).hit.any()


def test_two_views_between_which_nothing_changed(real_data: Path, tmp_path: Path) -> None:
    pair = VisitPair("Kitchen", 1, 4, (5,))
    (score,) = ObChangeBenchmark(real_data / "obchange_gh30", tmp_path, preset="fast")([pair])
    assert (score.changes, score.found, score.ap50) == (0, 0, None)
    kept = json.loads((tmp_path / "obchange.json").read_text())
    assert [row["pair"] for row in kept["pairs"]] == ["Kitchen_1_4_views_5"]
    folder = tmp_path / "pairs/Kitchen_1_4_views_5"
    assert [p.name for p in (folder / "before").iterdir()] == ["view_05.png"]
