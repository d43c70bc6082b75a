"""Judge networks on held-out two-view pairs.

``python -m baselines.cyws.evaluate --data SHARDS`` takes the shards of ``test``; with
``--rendered PAIRS --runs OUT`` it takes rendered pairs, and beside their true geometry that of the
finished runs OUT/<pair> of the method.
"""

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import process_time

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.table import Table

from baselines.cyws.average_precision import average_precision, hits
from baselines.cyws.boxes import Boxes, decode, filtered, grown
from baselines.cyws.pairs import TwoViews, in_batches, judged_pairs
from baselines.cyws.presets import Dimension
from baselines.cyws.rendered_folders import finished_geometry, read_rendered, resized, with_geometry
from baselines.cyws.scenes import SceneFrames, ScenesOf, read_shards
from baselines.cyws.weights import SHIPPED, load_network
from data_tools.benchmarks.box_ap import Convention
from scenediff_classic.errors import InputError, SceneDiffError
from scenediff_classic.workspace import write_atomic

WIDE = 20.0
"""Degrees of viewpoint change above which a pair counts as wide."""
SURE = 0.3
"""Score above which a box counts as reported."""


@dataclass(frozen=True)
class Scores:
    """Figures over many pairs; APs are of the boxes in both pictures together, at IoU 0.5."""

    pairs: int
    boxes: int
    """True boxes in all pictures."""
    ap50: float
    ap50_filtered: float
    """Without small boxes and such as overlap a better one (see `boxes.filtered`)."""
    ap50_narrow: float
    """Of pairs up to 20 degrees apart."""
    ap50_wide: float
    no_change_pairs: int
    false_boxes: float | None
    """Filtered boxes above 0.3 in both pictures of a pair without any change, on average; None
    without such pairs."""
    seconds: float
    """Processor time for a pair."""


@dataclass(frozen=True)
class Evaluate:
    """Print box AP and false boxes of the networks."""

    data: Path | None = None
    """Folder of shards with those of the split."""
    split: ScenesOf = "test"
    rendered: Path | None = None
    """Folder of rendered pairs, instead."""
    runs: Path | None = None
    """Folder of the method's finished runs on them, for the column of estimated geometry."""
    weights_3d: Path = SHIPPED["3d"]
    weights_2d: Path = SHIPPED["2d"]
    models: tuple[Dimension, ...] = ("3d", "2d")
    per_scene: int = 4
    """Pairs of frames from each scene."""
    convention: Convention = "half-open"
    """wide: all boxes grow by a pixel of the network's picture on every side, as they do in the
    published evaluation of CYWS-2D."""
    out: Path | None = None
    """File for the figures (JSON)."""

    def __call__(self) -> dict[str, Scores]:
        """Judge every network on the same pairs."""
        torch.set_num_threads(1)
        results: dict[str, Scores] = {}
        read: dict[tuple[int, int], dict[str, list[SceneFrames]]] = {}
        for model in self.models:
            path = self.weights_3d if model == "3d" else self.weights_2d
            network, preset = load_network(path)
            size = preset.height, preset.width
            if size not in read:
                read[size] = self._columns(size)
            columns = read[size]
            if model == "2d":
                columns = {"pictures": columns["true geometry"]}
            for name, scenes in columns.items():
                pairs = judged_pairs(scenes, self.per_scene)
                results[f"{model}, {name}"] = judge(network, pairs, convention=self.convention)
        Console().print(table(results))
        if self.out is not None:
            content = {name: _known(asdict(scores)) for name, scores in results.items()}
            write_atomic(self.out, json.dumps(content, indent=1, allow_nan=False) + "\n")
        return results

    def _columns(self, size: tuple[int, int]) -> dict[str, list[SceneFrames]]:
        if self.data is not None:
            scenes = read_shards(self.data / self.split)
            return {"true geometry": [resized(s, *size) for s in scenes]}
        if self.rendered is None:
            raise InputError("Give --data or --rendered.")
        folders = sorted(p.parent for p in self.rendered.glob("*/truth_geometry.npz"))
        if not folders:
            raise InputError(f"{self.rendered} holds no rendered pairs.")
        columns: dict[str, list[SceneFrames]] = {"true geometry": []}
        for folder in folders:
            scene = read_rendered(folder, size)
            columns["true geometry"].append(scene)
            if self.runs is not None:
                found = with_geometry(scene, finished_geometry(folder, self.runs / folder.name))
                columns.setdefault("estimated geometry", []).append(found)
        return columns


def judge(
    network: torch.nn.Module,
    pairs: Sequence[TwoViews],
    batch: int = 8,
    convention: Convention = "half-open",
) -> Scores:
    """Run a network over pairs of one size."""
    start = process_time()
    raw = _found(network, pairs, batch)
    seconds = (process_time() - start) / max(len(pairs), 1)
    turn = np.array([pair.turn for pair in pairs])
    height, width = pairs[0].images.shape[1:3]
    tidy = [(filtered(a, height, width), filtered(b, height, width)) for a, b in raw]
    quiet = [k for k, pair in enumerate(pairs) if not len(pair.boxes)]
    false = [int((boxes.score > SURE).sum()) for k in quiet for boxes in tidy[k]]

    def ap(boxes: Sequence[tuple[Boxes, Boxes]], chosen: np.ndarray) -> float:
        score, right, total = [], [], 0
        for k in np.flatnonzero(chosen).tolist():
            for side in (0, 1):
                truth, found = pairs[k].boxes[:, side], boxes[k][side]
                score.append(found.score)
                if convention == "wide":
                    found, truth = Boxes(grown(found.xyxy), found.score), grown(truth)
                right.append(hits(found, truth))
                total += len(truth)
        return average_precision(score, right, total)

    every = np.ones(len(pairs), bool)
    return Scores(
        pairs=len(pairs),
        boxes=sum(2 * len(pair.boxes) for pair in pairs),
        ap50=ap(raw, every),
        ap50_filtered=ap(tidy, every),
        ap50_narrow=ap(raw, turn <= WIDE),
        ap50_wide=ap(raw, turn > WIDE),
        no_change_pairs=len(quiet),
        false_boxes=2 * float(np.mean(false)) if false else None,
        seconds=seconds,
    )


def _found(
    network: torch.nn.Module, pairs: Sequence[TwoViews], batch: int
) -> list[tuple[Boxes, Boxes]]:
    network.eval()
    out: list[tuple[Boxes, Boxes]] = []
    for some in in_batches(pairs, batch):
        with torch.inference_mode():
            maps = network(some.images, some.registration)
        boxes = decode(maps, *some.images.shape[-2:])
        out.extend(zip(boxes[::2], boxes[1::2], strict=True))
    return out


def _known(figures: dict[str, float | None]) -> dict[str, float | None]:
    """An AP without any truth as None: JSON has no NaN."""
    return {k: v if v is None or math.isfinite(v) else None for k, v in figures.items()}


def table(results: dict[str, Scores]) -> Table:
    """The figures side by side, in percent."""
    out = Table(
        title=f"Box AP at IoU 0.5, both pictures (wide = more than {WIDE:.0f} degrees apart)"
    )
    heads = ("pairs", "boxes", "all", "filtered", "narrow", "wide", "false boxes", "ms a pair")
    out.add_column("network")
    for head in heads:
        out.add_column(head, justify="right")
    for name, s in results.items():
        aps = (s.ap50, s.ap50_filtered, s.ap50_narrow, s.ap50_wide)
        shown = "-" if s.false_boxes is None else f"{s.false_boxes:.2f}"
        false = f"{shown} ({s.no_change_pairs} pairs)"
        row = (f"{s.pairs}", f"{s.boxes}", *(f"{100 * v:.1f}" for v in aps), false)
        out.add_row(name, *row, f"{1000 * s.seconds:.0f}")
    return out


if __name__ == "__main__":
    try:
        tyro.cli(Evaluate)()
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
