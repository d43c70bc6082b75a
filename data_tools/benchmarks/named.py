"""The benchmarks by name."""

from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import Any

from data_tools.benchmarks.benchmark import Benchmark
from data_tools.benchmarks.changesim import CONDITIONS, ChangeSimBenchmark
from data_tools.benchmarks.mask_judge import checked_mode
from data_tools.benchmarks.obchange_benchmark import ObChangeBenchmark
from data_tools.benchmarks.paslcd import PaslcdBenchmark
from data_tools.benchmarks.rc3d_benchmark import Rc3dBenchmark
from data_tools.benchmarks.rendered_benchmark import RenderedBenchmark
from data_tools.benchmarks.scenediff import SceneDiffBenchmark
from scenediff_classic.errors import InputError
from scenediff_classic.evaluation.benchmark import SPLITS, SUBSETS


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


def _scenediff(
    root: Path, mode: str = "strict", split: str = "all", subset: str = "all"
) -> Benchmark[Any]:
    _check("split", split, ("all", *SPLITS))
    _check("subset", subset, ("all", *SUBSETS))
    chosen: Any = None if split == "all" else split
    part: Any = None if subset == "all" else subset
    return SceneDiffBenchmark(root, checked_mode(mode), chosen, part)


def _changesim(
    root: Path, split: str = "test", condition: str = "normal", every: int | str = 1
) -> Benchmark[Any]:
    _check("split", split, ("test", "train"))
    _check("condition", condition, CONDITIONS)
    if not str(every).isdecimal() or int(every) < 1:
        raise InputError(f"'every' should be a whole number from 1 on, not {every!r}.")
    chosen: Any = split
    light: Any = condition
    return ChangeSimBenchmark(root, chosen, light, int(every))


def _rc3d(
    root: Path, protocol: str = "raw", convention: str = "half-open", present: str = "first"
) -> Benchmark[Any]:
    _check("protocol", protocol, ("raw", "filtered"))
    _check("convention", convention, ("half-open", "wide"))
    _check("present", present, ("first", "second"))
    options: Any = {"protocol": protocol, "convention": convention, "present": present}
    return Rc3dBenchmark(root, **options)


def _paslcd(root: Path) -> Benchmark[Any]:
    return PaslcdBenchmark(root)


def _obchange(root: Path, work: Path | str | None = None) -> Benchmark[Any]:
    return ObChangeBenchmark(root, None if work is None else Path(work))


def _check(option: str, value: Any, choices: Sequence[str]) -> None:
    if value not in choices:
        raise InputError(f"'{option}' is {value!r}: choose {', '.join(choices)}.")


KINDS: Mapping[str, Callable[..., Benchmark[Any]]] = {
    "synthetic": _synthetic,
    "scenediff": _scenediff,
    "paslcd": _paslcd,
    "changesim": _changesim,
    "rc3d": _rc3d,
    "obchange": _obchange,
}
"""Kind -> what opens it; their parameters after the first are the options."""
