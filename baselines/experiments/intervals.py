"""How far a figure could be off because the pairs are few: bootstrap over pairs.

Pairs are drawn with replacement and the benchmark pools each draw, as it pools the whole. What is
kept are the 2.5 and 97.5 percentiles. The same seed draws the same pairs for every method, so two
methods are compared on equal draws.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int64

from data_tools.benchmarks.benchmark import Benchmark

DRAWS = 1000
COVERAGE = 95.0
"""Percent of the draws that an interval holds."""
_LEAST = 0.5
"""Share of the draws in which a figure must be defined, or it gets no interval."""

Interval = tuple[float, float]


@dataclass(frozen=True)
class Difference:
    """A figure of one run against the same figure of another one, on the same pairs."""

    first: float | None
    second: float | None
    difference: float | None
    """Second less first; None if one of them is undefined."""
    interval: Interval | None
    """Of the difference; None where it is undefined in most draws."""
    better: tuple[int, ...]
    """Positions of the pairs whose own figure rose."""
    worse: tuple[int, ...]

    @property
    def clear(self) -> bool:
        """Whether the interval excludes zero."""
        return self.interval is not None and (self.interval[0] > 0 or self.interval[1] < 0)


def drawn(pairs: int, draws: int, seed: int) -> Int64[np.ndarray, "draws pairs"]:
    """Which pairs each draw takes, with replacement."""
    return np.random.default_rng(seed).integers(0, pairs, (draws, pairs))


def bootstrap(
    benchmark: Benchmark[Any], judged: Sequence[Any], draws: int = DRAWS, seed: int = 0
) -> dict[str, Interval]:
    """Intervals of a benchmark's figures.

    Parameters
    ----------
    judged : sequence
        What `Benchmark.judge` gave for each pair.

    Returns
    -------
    Low and high end by key, from 0 to 1; a figure that is undefined in more than half of the
    draws is left out, and all are with fewer than two pairs.
    """
    if len(judged) < 2:
        return {}
    pooled = [benchmark.pool([judged[i] for i in draw]) for draw in drawn(len(judged), draws, seed)]
    ends = {key: _ends([figures.get(key) for figures in pooled]) for key in benchmark.metrics}
    return {key: found for key, found in ends.items() if found is not None}


def paired_difference(
    benchmark: Benchmark[Any],
    first: Sequence[Any],
    second: Sequence[Any],
    draws: int = DRAWS,
    seed: int = 0,
) -> dict[str, Difference]:
    """How the second run's figures differ from the first one's, by the benchmark's keys.

    Parameters
    ----------
    first, second : sequence
        What `Benchmark.judge` gave, for the same pairs in the same order.

    Raises
    ------
    ValueError
        If the two are not of equal length.
    """
    if len(first) != len(second):
        raise ValueError(f"{len(first)} judged pairs cannot be compared with {len(second)}.")
    whole = benchmark.pool(first), benchmark.pool(second)
    alone = [(benchmark.pool([a]), benchmark.pool([b])) for a, b in zip(first, second, strict=True)]
    pooled = []
    if len(first) > 1:
        for draw in drawn(len(first), draws, seed):
            own = [benchmark.pool([judged[i] for i in draw]) for judged in (first, second)]
            pooled.append((own[0], own[1]))
    return {key: _difference(key, whole, alone, pooled) for key in benchmark.metrics}


_Figures = Mapping[str, float | None]


def _difference(
    key: str,
    whole: tuple[_Figures, _Figures],
    alone: Sequence[tuple[_Figures, _Figures]],
    pooled: Sequence[tuple[_Figures, _Figures]],
) -> Difference:
    changes = [_less(figures, key) for figures in alone]
    return Difference(
        whole[0].get(key),
        whole[1].get(key),
        _less(whole, key),
        _ends([_less(figures, key) for figures in pooled]),
        tuple(i for i, change in enumerate(changes) if change is not None and change > 0),
        tuple(i for i, change in enumerate(changes) if change is not None and change < 0),
    )


def _less(figures: tuple[_Figures, _Figures], key: str) -> float | None:
    first, second = figures[0].get(key), figures[1].get(key)
    return None if first is None or second is None else second - first


def _ends(values: Sequence[float | None]) -> Interval | None:
    known = [value for value in values if value is not None]
    if not known or len(known) < _LEAST * len(values):
        return None
    rest = (100 - COVERAGE) / 2
    low, high = np.percentile(known, [rest, 100 - rest])
    return float(low), float(high)
