"""Benchmarks by the names that configurations and commands use."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from data_tools.benchmarks.benchmark import Benchmark
from data_tools.benchmarks.scenediff import SceneDiffBenchmark
from data_tools.benchmarks.synthetic_benchmark import SyntheticPairs
from scenediff_classic.errors import InputError

BENCHMARKS: Mapping[str, type[Any]] = {
    "synthetic": SyntheticPairs,
    "scenediff": SceneDiffBenchmark,
}


def open_benchmark(kind: str, root: Path, **options: Any) -> Benchmark[Any]:
    """The benchmark of a kind in a folder.

    Parameters
    ----------
    kind : str
        One of `BENCHMARKS`.
    root : Path
        Where it lies.
    options
        Fields of the benchmark's class, such as ``mode`` or ``name``.

    Raises
    ------
    InputError
        If there is no such kind or option, or a value is of another type.
    """
    if kind not in BENCHMARKS:
        raise InputError(f"There is no benchmark '{kind}': choose one of {', '.join(BENCHMARKS)}.")
    known = [f.name for f in fields(BENCHMARKS[kind]) if f.name != "root"]
    for name in options:
        if name not in known:
            raise InputError(
                f"The benchmark '{kind}' has no option '{name}', only {', '.join(known)}."
            )
    return BENCHMARKS[kind](root=root, **options)
