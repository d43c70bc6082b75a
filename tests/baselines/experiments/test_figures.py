"""Which frames and failures are shown, and what is said of an answer."""

import numpy as np
import pytest

from baselines.experiments.finished import FinishedRun, read_run
from baselines.experiments.gallery import worst_answers
from baselines.experiments.pair_pictures import (
    PairPictures,
    answer_picture,
    colour_of,
    key_frames,
    letter_of,
    read_pair,
    said,
    truth_picture,
)
from baselines.experiments.sections import swept
from baselines.experiments.space import first_geometry, scene_of
from baselines.experiments.truths import matches, overlaps
from tests.baselines.experiments.finished_run import BENCHMARK, METHODS, PAIRS, write_finished_run

Shown = tuple[FinishedRun, dict[str, PairPictures]]


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Shown:
    folder, pairs = write_finished_run(tmp_path_factory.mktemp("figures"))
    run = read_run(folder)
    return run, {p.name: read_pair(run, BENCHMARK, p, METHODS) for p in pairs[BENCHMARK]}


def test_answers_are_told_in_words(shown: Shown) -> None:
    _, pictures = shown
    changed, quiet = (pictures[name] for name in PAIRS)
    assert said(changed, changed.answers[0]) == "3 of 3 found"
    assert said(changed, changed.answers[1]) == "1 of 3 found · missed B, C"
    assert said(quiet, quiet.answers[0]) == "0 of 0 found"
    assert said(quiet, quiet.answers[1]).startswith("failed: Only 1 frame")


def test_key_frames_see_what_changed(shown: Shown) -> None:
    changed = shown[1][PAIRS[0]]
    spots = key_frames(changed, 2)
    assert {video for video, _ in spots} == {"before", "after"}
    seen = {t.id for t in changed.truth or () for spot in spots if spot in t.views}
    assert seen == {t.id for t in changed.truth or ()}
    assert len(key_frames(shown[1][PAIRS[1]], 2)) == 2, "without change, the middle of each capture"


def test_what_is_found_is_painted_as_in_the_truth_and_what_is_missed_is_not_filled(
    shown: Shown,
) -> None:
    changed = shown[1][PAIRS[0]]
    spot = key_frames(changed, 1)[0]
    plain, truth = changed.frame(spot), truth_picture(changed, spot)
    full, part = (answer_picture(changed, answer, spot) for answer in changed.answers)
    assert plain is not None
    assert truth is not None
    np.testing.assert_array_equal(full, truth)
    assert (part != truth).any()
    assert (truth != plain).any()


def test_reported_objects_are_matched_once() -> None:
    iou = np.array([[0.6, 0.0], [0.9, 0.1], [0.0, 0.5]])
    assert matches(iou) == {0: 0}, "the more confident one keeps it, and one half is not enough"


def test_overlaps_count_all_frames() -> None:
    left, right = np.zeros((2, 2), bool), np.zeros((2, 2), bool)
    left[:, 0], right[:] = True, True
    found = overlaps(
        {(0, ("before", 0)): left, (0, ("after", 3)): right},
        {(0, ("before", 0)): right, (0, ("after", 4)): right},
        (1, 1),
    )
    assert found[0, 0] == pytest.approx(2 / (2 + 4 + 4 + 4 - 2))


def test_the_gallery_starts_with_the_worst_and_leaves_out_what_is_right(shown: Shown) -> None:
    worst = worst_answers(shown[0], BENCHMARK, "px_im_iou", 9)
    assert [(w.pair, METHODS[w.column], w.figure) for w in worst] == [
        (PAIRS[1], METHODS[1], 0.0),
        (PAIRS[0], METHODS[1], 0.25),
    ]


def test_the_scene_has_the_boxes_of_all_answers_on_the_same_cameras(shown: Shown) -> None:
    changed = shown[1][PAIRS[0]]
    placed = first_geometry(changed)
    assert placed is not None
    scene = scene_of(changed, *placed)
    assert scene is not None
    assert list(scene["answers"]) == list(METHODS)
    assert [box["name"] for box in scene["answers"][METHODS[0]]] == ["A", "B", "C"]
    first = scene["answers"][METHODS[1]][0]
    assert first == scene["answers"][METHODS[0]][0]


def test_settings_that_differ_by_a_number_are_found() -> None:
    found = swept(["default", "a.b=0.5", "a.b=1e-3", "c=on", "d=1", "e=nan", "=3"])
    assert found == {"a.b": {"a.b=0.5": 0.5, "a.b=1e-3": 1e-3}, "d": {"d=1": 1.0}}


def test_letters_and_colours_go_on_without_end() -> None:
    assert [letter_of(i) for i in (0, 25, 26, 53)] == ["A", "Z", "A1", "B2"]
    assert colour_of(0) == colour_of(8) != colour_of(1)
