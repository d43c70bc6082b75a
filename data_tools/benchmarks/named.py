"""The benchmarks by name."""

from collections.abc import Callable, Mapping
from inspect import signature
from pathlib import Path
from typing import Any

from data_tools.benchmarks.benchmark import Benchmark
from data_tools.benchmarks.mask_judge import checked_mode
from data_tools.benchmarks.rendered_benchmark import RenderedBenchmark
from scenediff_classic.errors import InputError


def open_benchmark(kind: str, root: Path, **options: Any) -> Benchmark[Any]:
    """The benchmark of that kind in a folder.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    options
        As the kind takes them: see docs/benchmarks.md.

    Raises
    ------
    InputError
        There is no such kind, option, or value of an option, or no such folder.
    """
    if kind not in KINDS:
        raise InputError(f"'{kind}' is no benchmark: choose {', '.join(KINDS)}.")
    taken = options_of(kind)
    for option in options:
        if option not in taken:
            there = f"choose {', '.join(taken)}" if taken else "it takes none"
            raise InputError(f"'{option}' is no option of the benchmark '{kind}': {there}.")
    if not root.is_dir():
        raise InputError(f"{root} is not a folder: give the folder of the benchmark '{kind}'.")
    return KINDS[kind](root, **options)


def options_of(kind: str) -> tuple[str, ...]:
    """Names of the options that a kind takes."""
    return tuple(signature(KINDS[kind]).parameters)[1:]


def _synthetic(root: Path, mode: str = "strict") -> Benchmark[Any]:
    return RenderedBenchmark(root, checked_mode(mode))


KINDS: Mapping[str, Callable[..., Benchmark[Any]]] = {"synthetic": _synthetic}
"""Kind -> what opens it; their parameters after the first are the options."""
