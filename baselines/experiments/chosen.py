"""The benchmarks of an experiment, and those of their pairs that it asks for."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from baselines.experiments.config import BenchmarkSpec
from data_tools.benchmarks.benchmark import Benchmark, BenchmarkPair
from scenediff_classic.errors import InputError


@dataclass(frozen=True)
class Chosen:
    """A benchmark, and those of its pairs that are compared on."""

    spec: BenchmarkSpec
    benchmark: Benchmark[Any]
    pairs: tuple[BenchmarkPair, ...]


def opened(specs: Sequence[BenchmarkSpec]) -> tuple[Chosen, ...]:
    """The benchmarks with the pairs that are asked for.

    Raises
    ------
    InputError
        If one cannot be opened, two have one name, or there is no pair of a given name.
    """
    out: list[Chosen] = []
    for spec in specs:
        benchmark = _opened(spec)
        if any(benchmark.name == c.benchmark.name for c in out):
            raise InputError(f"Two benchmarks of the experiment are called '{benchmark.name}'.")
        pairs = tuple(p for p in benchmark.pairs() if not spec.scenes or p.name in spec.scenes)
        out.append(Chosen(spec, benchmark, pairs[: spec.limit]))
    have = {p.name for c in out for p in c.pairs}
    for spec in specs:
        for scene in spec.scenes:
            if scene not in have and spec.limit is None:
                raise InputError(f"No benchmark of the experiment has the pair '{scene}'.")
    if not have:
        raise InputError("The experiment has no pairs: check roots, scenes and limits.")
    return tuple(out)


def _opened(spec: BenchmarkSpec) -> Benchmark[Any]:
    """By a name that `open_benchmark` knows, or ``module:function`` with the same arguments."""
    module, _, attribute = spec.kind.partition(":")
    try:
        if not attribute:
            from data_tools.benchmarks.named import open_benchmark

            return open_benchmark(spec.kind, spec.root, **spec.options)
        opener = getattr(importlib.import_module(module), attribute)
        return opener(spec.root, **spec.options)
    except (ImportError, AttributeError) as error:
        raise InputError(f"The benchmark '{spec.kind}' cannot be imported: {error}.") from error
    except TypeError as error:
        raise InputError(
            f"The options of the benchmark '{spec.kind}' do not fit: {error}."
        ) from error
