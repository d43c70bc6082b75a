"""Name all problems of a folder: ``python -m data_tools.benchmarks.validate KIND ROOT``."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from data_tools.benchmarks.annotated import statistics
from data_tools.benchmarks.mask_scores import MaskScores
from data_tools.benchmarks.named import open_benchmark
from scenediff_classic.dataset import read_annotations
from scenediff_classic.errors import InputError, SceneDiffError


@dataclass(frozen=True)
class Validate:
    """Check a benchmark's folder; says what it holds if nothing is wrong."""

    kind: tyro.conf.Positional[str]
    """synthetic, scenediff, ... (see docs/benchmarks.md)."""
    root: tyro.conf.Positional[Path]
    """The benchmark's folder."""
    options: str = "{}"
    """Further options of the benchmark, as JSON."""

    def __call__(self) -> int:
        """Print the problems, or a summary; returns the exit code."""
        try:
            options = json.loads(self.options)
        except ValueError as error:
            raise InputError(f"--options is not JSON: {error}.") from error
        if not isinstance(options, dict):
            raise InputError('--options must be a JSON object, such as \'{"split": "val"}\'.')
        benchmark = open_benchmark(self.kind, self.root, **options)
        problems = benchmark.problems()
        for problem in problems:
            print(problem)
        if problems:
            print(f"{len(problems)} problems.", file=sys.stderr)
            return 1
        pairs = benchmark.pairs()
        print(f"{self.root}: {len(pairs)} pairs, no problem found.")
        if isinstance(benchmark, MaskScores):
            about = statistics(read_annotations(p.truth) for p in pairs if p.truth is not None)
            kinds = ", ".join(f"{n} {kind}" for kind, n in sorted(about.objects.items()))
            print(
                f"{sum(about.objects.values())} objects ({kinds}), {about.regions} masks in "
                f"{about.frames} sampled frames, median {100 * about.median_area:.2f} % of "
                "a picture."
            )
        return 0


if __name__ == "__main__":
    try:
        sys.exit(tyro.cli(Validate)())
    except SceneDiffError as error:
        sys.exit(f"Error: {error}")
