"""A small finished run: boxes on a floor, two methods, three settings, two pairs, one failure.

The first pair changes, the second does not. Answers are the truth or a part of it, so that what the
page has to say of them is known.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from PIL import Image

from data_tools.benchmarks.benchmark import BenchmarkPair
from scenediff_classic.dataset import SAMPLE_STEP
from scenediff_classic.detection_run import CaptureOptions
from scenediff_classic.geometry.store import save_geometry
from scenediff_classic.report.overlays import write_overlays
from scenediff_classic.result import write_result, write_run
from scenediff_classic.result.score_maps import write_scores
from scenediff_classic.types import VIDEOS, Capture, ChangeResult
from tests.report.example import Example, example

BENCHMARK = "boxes"
METHODS = ("all <found>", "first only")
SETTINGS = ("default", "core.threshold=0.2", "core.threshold=0.4")
HEADINGS = {"px_im_iou": "px/im IoU", "obj_sc_ap": "obj/sc AP"}
PAIRS = ("changed & moved", "quiet")


def write_finished_run(root: Path) -> tuple[Path, dict[str, Sequence[BenchmarkPair]]]:
    """The run's folder, and the pairs that it is about."""
    run, pairs, cells = root / "run", [], []
    examples = dict(zip(PAIRS, (example(), example(changed=False)), strict=True))
    for name, made in examples.items():
        pairs.append(_write_captures(made, name, root / "data" / name))
    for setting in SETTINGS:
        for method in METHODS:
            if setting != "default" and method != METHODS[0]:
                continue
            for pair in pairs:
                cells.append(_write_cell(run, setting, method, pair, examples[pair.name]))
    scores = [_score(setting, method) for setting, method in dict.fromkeys(
        (c["setting"], c["method"]) for c in cells)]  # fmt: skip
    about = {
        "schema": 1, "name": "boxes & co", "benchmarks": [BENCHMARK], "methods": list(METHODS),
        "config": {"benchmarks": [{"kind": "boxes", "root": "data"}], "draws": 200},
        "settings": list(SETTINGS), "seed": 7, "versions": {"numpy": "2.4.0"}, "git_commit": None,
        "machine": {"cpu": "some <cpu>", "cores": 2, "memory_bytes": 8e9, "platform": "Linux"},
        "started": "2026-01-01T10:00:00", "finished": "2026-01-01T10:05:00",
    }  # fmt: skip
    for stem, content in (("experiment", about), ("cells", cells), ("scores", scores)):
        (run / f"{stem}.json").write_text(json.dumps(content))
    return run, {BENCHMARK: tuple(pairs)}


def _write_captures(made: Example, name: str, folder: Path) -> BenchmarkPair:
    for video, capture in (("before", made.before), ("after", made.after)):
        (folder / video).mkdir(parents=True)
        for frame in capture.frames:
            Image.fromarray(frame.image).save(folder / video / f"{frame.index:04d}.png")
    (folder / "segments.json").write_text(json.dumps(_segments(made.result)))
    return BenchmarkPair(
        name, CaptureOptions(folder / "before"), CaptureOptions(folder / "after"),
        "busy" if made.result.objects else "quiet", folder,
    )  # fmt: skip


def _segments(result: ChangeResult) -> dict[str, Any]:
    tracks: dict[str, dict[str, dict[str, Any]]] = {"before": {}, "after": {}}
    for item in result.objects:
        for view in item.views:
            rle = {"size": list(view.mask.size), "counts": view.mask.counts}
            tracks[view.video].setdefault(str(item.id), {})[str(SAMPLE_STEP * view.frame)] = rle
    objects = [
        {
            "label": f"box_{item.id}", "in_video1": item.kind != "added",
            "in_video2": item.kind != "removed", "original_obj_idx": item.id,
        }
        for item in result.objects
    ]  # fmt: skip
    return {
        "schema": 1, "scene_type": "boxes", "video1_objects": tracks["before"],
        "video2_objects": tracks["after"], "objects": objects,
    }  # fmt: skip


def _write_cell(
    run: Path, setting: str, method: str, pair: BenchmarkPair, made: Example
) -> dict[str, Any]:
    place = Path("results") / setting / method.strip("<>") / BENCHMARK / pair.name
    fails = method == METHODS[1] and pair.name == PAIRS[1]
    head = {
        "method": method, "setting": setting, "benchmark": BENCHMARK, "pair": pair.name,
        "group": pair.group,
    }  # fmt: skip
    if fails:
        why = "Only 1 frame could be placed: film <more> overlap."
        return {**head, "status": "failed", "reason": why, "seconds": 0, "stage_seconds": {},
                "peak_memory_bytes": None, "output": None}  # fmt: skip
    kept = made.result.objects if method == METHODS[0] else made.result.objects[:1]
    result = replace(made.result, objects=kept)
    folder = run / place
    folder.mkdir(parents=True)
    captures: dict[Any, Capture] = dict(zip(VIDEOS, (made.before, made.after), strict=True))
    save_geometry(made.evidence.geometry, folder / "geometry")
    write_scores(made.evidence.geometry.views, made.evidence.scores, folder / "scores")
    write_overlays(result, captures["before"], captures["after"], folder / "overlays")
    (folder / "report.html").write_text("a page")
    write_result(result, folder / "changes.json")
    write_run(made.run, folder / "run.json")
    return {**head, "status": "done", "reason": None, "seconds": 12.5,
            "stage_seconds": {"geometry": 10.0, "scores": 2.5}, "peak_memory_bytes": 1_500_000_000,
            "output": place.as_posix()}  # fmt: skip


def _score(setting: str, method: str) -> dict[str, Any]:
    worth = {METHODS[0]: 1.0, METHODS[1]: 0.25}[method] - 0.5 * SETTINGS.index(setting) / 2
    figures = dict.fromkeys(HEADINGS, worth)
    nothing = dict.fromkeys(HEADINGS)
    return {
        "method": method, "setting": setting, "benchmark": BENCHMARK, "metrics": figures,
        "headings": HEADINGS, "groups": {"busy": figures, "quiet": nothing},
        "intervals": {key: [worth / 2, worth] for key in HEADINGS},
        "pairs": {PAIRS[0]: figures, PAIRS[1]: nothing},
    }  # fmt: skip
