"""Random scenes, scored a second time pixel by pixel.

The twin works on dense masks, resizes with torch, walks through frames one at a time and never
forms an IoU table: it shares no code with the package but the grid sizes and the last step from
judged detections to average precision, which have their own tests.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import torch

from scenediff_classic import masks
from scenediff_classic.dataset import AnnotatedPair, Prediction
from scenediff_classic.evaluation import Ranking, Rules, rules_of, score_pair
from scenediff_classic.types import VIDEOS
from tests.evaluation.scenes import predicted, prediction, truth

SIZE = (18, 32)


def small_rules(mode) -> Rules:
    """The mode's rules on a sixteenth of its grid, to save time."""
    rules = rules_of(mode)

    def grid(pair, guess):
        full = rules.grid(pair, guess)
        return lambda video, frame: tuple(side // 16 for side in full(video, frame))

    return replace(rules, grid=grid)


def random_mask(rng, size):
    top, left = rng.integers(0, size[0] - 4), rng.integers(0, size[1] - 4)
    mask = np.zeros(size, bool)
    mask[top : top + rng.integers(1, 9), left : left + rng.integers(1, 9)] = True
    return masks.encode(mask)


def random_scene(seed: int) -> tuple[AnnotatedPair, Prediction]:
    """Truth, and a prediction made of kept, shifted, mistyped, repeated and invented objects."""
    rng = np.random.default_rng(seed)
    captures = [("before",), ("after",), ("before", "after")]
    things = [
        {v: {int(k): random_mask(rng, SIZE) for k in rng.permutation(4)[:3]} for v in present}
        for present in (captures[i] for i in rng.integers(0, 3, 5))
    ]
    guesses = [(float(rng.integers(1, 5)) / 4, dict(thing)) for thing in things[1:]]
    guesses += [(0.5, dict(things[1])), (0.75, {"before": {}, "after": {}, **things[2]})]
    guesses += [(0.25, {v: {0: random_mask(rng, SIZE)} for v in VIDEOS}), (0.9, {"after": {}})]
    for _, guess in guesses:
        for video, views in list(guess.items()):
            keep = {k: m for k, m in views.items() if rng.random() < 0.8}
            guess[video] = {
                k: m if rng.random() < 0.7 else random_mask(rng, (9, 16)) for k, m in keep.items()
            }
    return truth(*things), prediction(*(guesses[i] for i in rng.permutation(len(guesses))))


@dataclass
class Twin:
    """Dense masks of both sides, keyed by (video, frame), then by object."""

    grid: object
    true: dict = field(default_factory=dict)
    guessed: dict = field(default_factory=dict)

    def add(self, side, owner, video, frame, rle):
        pixels = torch.from_numpy(masks.decode(rle))[None, None].float()
        size = self.grid(video, frame)
        resized = torch.nn.functional.interpolate(pixels, size=size, mode="nearest")[0, 0] > 0.5
        side.setdefault((video, frame), {})[owner] = resized.numpy()

    def frames(self):
        return sorted(set(self.true) | set(self.guessed))

    def of_frame(self, frame):
        return self.true.get(frame, {}), self.guessed.get(frame, {})

    def object_iou(self, guess, thing):
        shared = total = 0
        for frame in self.frames():
            true, guessed = self.of_frame(frame)
            empty = np.zeros(self.grid(*frame), bool)
            a, b = guessed.get(guess, empty), true.get(thing, empty)
            shared, total = shared + (a & b).sum(), total + (a | b).sum()
        return shared / total if total else 0.0

    def region_iou(self, frame, guess, thing):
        a, b = self.guessed[frame][guess], self.true[frame][thing]
        return (a & b).sum() / (a | b).sum() if (a | b).any() else 0.0


def judge(detections, truths, overlap, free_choice):
    """Detections are (confidence, key), most confident first; returns (confidence, hit)."""
    taken, judged = set(), []
    for confidence, key in sorted(detections, key=lambda d: -d[0]):
        choice, highest = None, 0.5
        for candidate in truths:
            if free_choice and candidate in taken:
                continue
            value = overlap(key, candidate)
            if value > highest:
                choice, highest = candidate, value
        judged.append((confidence, choice is not None and choice not in taken))
        taken.add(choice)
        taken.discard(None)
    return judged


def build(pair, guess, mode) -> Twin:
    twin = Twin(small_rules(mode).grid(pair, guess))
    for item in pair.objects:
        for video in VIDEOS:
            track = pair.track(video, item.object_id)
            for annotated in track.masks if track else ():
                frame = annotated.frame // 30
                twin.add(twin.true, item.object_id, video, frame, annotated.mask)
    for number, item in enumerate(guess.objects):
        for view in item.views:
            twin.add(twin.guessed, number, view.video, view.frame, view.mask)
    return twin


def as_lists(ranking: Ranking):
    return list(zip(ranking.confidence.tolist(), ranking.hit.tolist(), strict=True))


@pytest.mark.parametrize("mode", ["official", "strict"])
@pytest.mark.parametrize("seed", range(10))
def test_agrees_with_the_twin(seed, mode):
    pair, guess = random_scene(seed)
    scores = score_pair(pair, guess, small_rules(mode))
    twin, free = build(pair, guess, mode), mode == "strict"

    unions = [
        [np.any([np.zeros(twin.grid(*f), bool), *side.values()], axis=0) for side in sides]
        for f, sides in ((f, twin.of_frame(f)) for f in twin.frames())
    ]
    pixels = [(t & g, ~t & g, t & ~g) for t, g in unions]
    assert (scores.pixels.hit, scores.pixels.false, scores.pixels.missed) == tuple(
        sum(int(m.sum()) for m in column) for column in zip(*pixels, strict=True)
    )

    views = [
        (v.confidence, ((v.video, v.frame), n))
        for n, item in enumerate(guess.objects)
        for v in item.views
    ]
    regions = [(frame, thing) for frame in twin.true for thing in twin.true[frame]]
    regions.sort(key=lambda r: r[1])
    assert scores.regions.positives == len(regions)
    assert as_lists(scores.regions) == judge(
        views,
        regions,
        lambda d, r: twin.region_iou(d[0], d[1], r[1]) if d[0] == r[0] else 0.0,
        free,
    )

    things = [
        (np.mean([v.confidence for v in item.views]) if item.views else 0.0, n)
        for n, item in enumerate(guess.objects)
    ]
    names = [item.object_id for item in pair.objects]
    assert as_lists(scores.objects) == judge(things, names, twin.object_iou, free)

    def typed(n, name):
        mine, theirs = guess.objects[n].kind, pair.objects[name].kind
        agree = mine == theirs if free else (mine == "moved") == (theirs == "moved")
        return twin.object_iou(n, name) if agree else 0.0

    assert as_lists(scores.typed_objects) == judge(things, names, typed, free)
    assert scores.objects.positives == scores.typed_objects.positives == len(names)


def test_the_scenes_are_not_trivial():
    """The comparison above means something only if there are hits, misses and duplicates."""
    scored = [score_pair(*random_scene(seed), small_rules("official")) for seed in range(10)]
    for rankings in ([s.regions for s in scored], [s.objects for s in scored]):
        hits = np.concatenate([r.hit for r in rankings])
        assert 0.2 < hits.mean() < 0.9
    assert any(s.objects.hit.sum() != s.typed_objects.hit.sum() for s in scored)


@pytest.mark.parametrize("mode", ["official", "strict"])
def test_the_truth_itself_is_perfect(mode):
    pair, _ = random_scene(3)
    copies = [
        predicted(i, 0.5, {v: _views(pair, v, i) for v in VIDEOS if item.present(v)})
        for i, item in enumerate(pair.objects)
    ]
    scores = score_pair(pair, Prediction(tuple(copies)), small_rules(mode))
    for ranking in (scores.regions, scores.objects, scores.typed_objects):
        assert ranking.hit.all()
        assert ranking.hit.sum() == ranking.positives
    assert scores.pixels.false == scores.pixels.missed == 0


def _views(pair, video, number):
    track = pair.track(video, number)
    return {m.frame // 30: m.mask for m in track.masks}
