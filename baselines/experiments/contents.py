"""What a benchmark holds, and what each method finds of every kind of change."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from baselines.experiments.comparisons import about
from baselines.experiments.finished import FinishedRun
from baselines.experiments.pair_pictures import PairPictures
from baselines.experiments.tables import Column, Table, Value, number, texts
from scenediff_classic.masks import area
from scenediff_classic.report.palette import KIND_COLOUR
from scenediff_classic.types import VIDEOS

_KINDS = tuple(KIND_COLOUR)


def statistics_table(run: FinishedRun, benchmark: str, pairs: Sequence[PairPictures]) -> Table:
    """Frames, sizes and changes of the pairs whose frames could be read."""
    rows = []
    for name, chosen in _by_group(pairs):
        frames = [len(p.captures[v].frames) for p in chosen for v in VIDEOS]
        sizes = Counter((f.width, f.height) for p in chosen for v in VIDEOS
                        for f in p.captures[v].frames)  # fmt: skip
        kinds = Counter(t.kind for p in chosen for t in p.truth or ())
        annotated = [p for p in chosen if p.truth is not None]
        empty = sum(not p.truth for p in annotated)
        rows.append(
            texts(
                name, len(chosen), _span(frames),
                ", ".join(f"{w}\N{MULTIPLICATION SIGN}{h}" for (w, h), _ in sizes.most_common(2)),
                *(kinds[kind] for kind in _KINDS), empty, number(_share(annotated), 2, 100),
            )
        )  # fmt: skip
    names = ("group", "pairs", "frames a capture", "picture", *_KINDS, "without change",
             "mean object area %")  # fmt: skip
    return Table(
        f"statistics-{benchmark}", "The data", about(run, benchmark),
        tuple(Column(n, number=n not in ("group", "picture")) for n in names), tuple(rows),
        ("Objects are counted once a pair. Area: share of the picture that an annotated mask "
         "covers, averaged over all masks in sampled frames.",),
    )  # fmt: skip


def kind_table(run: FinishedRun, benchmark: str, pairs: Sequence[PairPictures]) -> Table | None:
    """What is found of each kind of change, and with the right kind; None without masks."""
    judged = [p for p in pairs if p.truth is not None]
    totals = Counter(t.kind for p in judged for t in p.truth or ())
    if not totals:
        return None
    titles = list(dict.fromkeys(a.title for p in judged for a in p.answers))
    rows = []
    for title in titles:
        found, right, false, answered = Counter[str](), Counter[str](), 0, 0
        for pictures in judged:
            for answer in (a for a in pictures.answers if a.title == title):
                answered += answer.result is not None
                false += len(answer.things) - len(answer.found)
                for i, j in answer.found.items():
                    kind = (pictures.truth or ())[j].kind
                    found[kind] += 1
                    right[kind] += answer.things[i].kind == kind
        values = []
        for kind in _KINDS:
            values += texts(f"{found[kind]} of {totals[kind]}", right[kind])
        rows.append((Value(title), *values, Value(str(false)), Value(str(len(judged) - answered))))
    columns = [Column("method", number=False)]
    for kind in _KINDS:
        columns += [Column(f"{kind} found"), Column(f"as {kind}")]
    return Table(
        f"kinds-{benchmark}", "By kind of change", about(run, benchmark, "objects"),
        (*columns, Column("none of them"), Column("failed pairs")), tuple(rows),
        ("Found: IoU over all frames above one half with a reported object of whatever kind, most "
         "confident first. 'As': of these, reported as the right kind. 'None of them': reported "
         "objects that match no true one. Masks are compared at 320 pixels, so single objects near "
         "the limit can differ from the figures above.",),
    )  # fmt: skip


def _by_group(pairs: Sequence[PairPictures]) -> list[tuple[str, list[PairPictures]]]:
    """All, then each group if there are several."""
    names = list(dict.fromkeys(p.pair.group for p in pairs))
    out = [("all", list(pairs))]
    if len(names) > 1:
        out += [(n or "none", [p for p in pairs if p.pair.group == n]) for n in names]
    return out


def _span(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return str(low) if low == high else f"{low}\N{EN DASH}{high}"


def _share(pairs: Sequence[PairPictures]) -> float | None:
    shares = [
        area(view.mask) / (view.mask.size[0] * view.mask.size[1])
        for p in pairs
        for thing in p.truth or ()
        for view in thing.views.values()
    ]
    return float(np.mean(shares)) if shares else None
