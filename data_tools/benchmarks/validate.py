"""Say everything that is wrong with a benchmark's folder, or what it holds.

``python -m data_tools.benchmarks.validate KIND ROOT [OPTION=VALUE ...]`` prints a sentence for each
problem and exits with 1, or prints pairs, groups and objects and exits with 0. Kinds and their
options are in docs/benchmarks.md.
"""

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import tyro
from rich.console import Console
from rich.table import Table

from data_tools.benchmarks.benchmark import Benchmark
from data_tools.benchmarks.named import open_benchmark
from scenediff_classic.errors import InputError, SceneDiffError


@runtime_checkable
class Described(Protocol):
    """A benchmark that can count what it holds."""

    def statistics(self) -> Mapping[str, float]:
        """Name -> number; shares are from 0 to 1. Without ``pairs``, these are counted as well."""
        ...


def dataset_statistics(benchmark: Benchmark[Any]) -> dict[str, float]:
    """Pairs, pairs of each group, and what the benchmark itself counts.

    Raises
    ------
    InputError
        Something is wrong with the folder.
    """
    counted = benchmark.statistics() if isinstance(benchmark, Described) else {}
    if "pairs" in counted:  # some benchmarks would have to write their pairs first
        return dict(counted)
    pairs = benchmark.pairs()
    groups = Counter(pair.group for pair in pairs if pair.group)
    return {
        "pairs": len(pairs),
        **{f"pairs: {group}": number for group, number in groups.items()},
        **counted,
    }


@dataclass(frozen=True)
class Validate:
    """Check a benchmark's folder."""

    kind: tyro.conf.Positional[str]
    """synthetic, scenediff, paslcd, changesim, rc3d or obchange."""
    root: tyro.conf.Positional[Path]
    """Folder of the benchmark."""
    options: tyro.conf.Positional[tuple[str, ...]] = ()
    """Options of the kind, as mode=official."""

    def __call__(self) -> int:
        """Print what was found; returns the exit code."""
        benchmark = open_benchmark(self.kind, self.root, **parsed_options(self.options))
        problems = benchmark.problems()
        if problems:
            print("\n".join(problems))
            print(f"{len(problems)} problem{'s' if len(problems) > 1 else ''} in {self.root}.")
            return 1
        table = Table("", "number", title=f"{benchmark.name}: no problems in {self.root}")
        for name, number in dataset_statistics(benchmark).items():
            table.add_row(name, f"{number:.4f}" if isinstance(number, float) else str(number))
        Console().print(table)
        return 0


def parsed_options(words: Sequence[str]) -> dict[str, str]:
    """``name=value`` words as a mapping.

    Raises
    ------
    InputError
        A word is of another form, or names an option twice.
    """
    found: dict[str, str] = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not (name and equals) or name in found:
            raise InputError(f"'{word}' should be an option as mode=official, each one once.")
        found[name] = value
    return found


def main(arguments: list[str] | None = None) -> int:
    """Entry point of the command."""
    program = "python -m data_tools.benchmarks.validate"
    try:
        return tyro.cli(Validate, args=arguments, prog=program)()
    except SceneDiffError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
