"""Truth and answers as masks of objects: the SceneDiff Benchmark's scores, pair by pair."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from scenediff_classic import masks
from scenediff_classic.dataset import (
    SAMPLE_STEP,
    Prediction,
    find_prediction,
    read_annotations,
    read_prediction,
)
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.pairs import PairScores, score_pair, summarise
from scenediff_classic.evaluation.rules import Mode, Rules, rules_of

MASK_METRICS: Mapping[str, str] = {
    "px_im_iou": "px/im IoU",
    "obj_im_ap": "obj/im AP",
    "obj_sc_ap": "obj/sc AP",
    "obj_sc_ap_typed": "obj/sc AP, typed",
}


@dataclass(frozen=True)
class MaskJudge:
    """The half of a benchmark that compares masks of objects with masks of objects."""

    mode: Mode = "strict"

    @property
    def rules(self) -> Rules:
        """What the mode decides."""
        return rules_of(self.mode)

    def judge(self, truth: Path, run: Path | None) -> PairScores | None:
        """Compare the answer in a folder with the truth.

        Parameters
        ----------
        truth : Path
            ``segments.json`` or ``segments.pkl``, or the folder of one of them.
        run : Path, optional
            Folder with ``changes.json`` or ``object_masks.pkl``; None without an answer.

        Returns
        -------
        PairScores, optional
            None for a pair that official mode leaves out, for want of an answer.

        Raises
        ------
        InputError
            The truth or the answer is there but cannot be read.
        """
        answer = None if run is None else find_prediction(run)
        if answer is None and not self.rules.counts_missing:
            return None
        found = Prediction(()) if answer is None else read_prediction(answer)
        return score_pair(read_annotations(truth), found, self.rules)

    def pool(self, judged: Sequence[PairScores | None]) -> dict[str, float | None]:
        """Figures by the keys of `MASK_METRICS`; pairs that were left out do not count."""
        metrics = summarise([scores for scores in judged if scores is not None], self.rules)
        return {key: getattr(metrics, key) for key in MASK_METRICS}


def checked_mode(mode: str) -> Mode:
    """The mode of that name.

    Raises
    ------
    InputError
        There is none.
    """
    if mode == "strict" or mode == "official":
        return mode
    raise InputError(f"'{mode}' is no evaluation mode: choose strict or official.")


def mask_statistics(truths: Sequence[Path]) -> dict[str, float]:
    """What some truths hold: objects by kind, annotated sampled frames, visible area.

    The area is the median over masks at sampled frames, as a share of the picture.
    """
    kinds: Counter[str] = Counter()
    frames, shares = 0, []
    for path in truths:
        truth = read_annotations(path)
        kinds.update(item.kind for item in truth.objects if item.kind is not None)
        shown = {
            (t.video, m.frame): m.mask.size
            for t in truth.tracks
            for m in t.masks
            if m.frame % SAMPLE_STEP == 0
        }
        frames += len(shown)
        shares += [
            masks.area(m.mask) / (m.mask.size[0] * m.mask.size[1])
            for t in truth.tracks
            for m in t.masks
            if m.frame % SAMPLE_STEP == 0
        ]
    return {
        "objects": sum(kinds.values()),
        **{kind: kinds[kind] for kind in ("added", "removed", "moved")},
        "frames with a mask": frames,
        "masks": len(shares),
        "median visible area": median(shares) if shares else 0.0,
    }
