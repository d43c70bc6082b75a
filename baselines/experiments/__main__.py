"""``scenediff-experiments``: run a comparison of methods, and compare two runs."""

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from baselines.experiments.comparing import as_json, compare, compared_tables
from baselines.experiments.config import ExperimentConfig, read_config
from baselines.experiments.driving import Workers
from baselines.experiments.page import headline
from baselines.experiments.running import Report, run_experiment
from baselines.experiments.showing import Show
from scenediff_classic.errors import InputError
from scenediff_classic.terminal import OUT, run_command, shown
from scenediff_classic.workspace import write_atomic


@dataclass(frozen=True)
class SlurmOptions:
    """Of each Slurm job; what is left out comes from dask's own configuration files."""

    queue: str | None = None
    account: str | None = None
    cores: int | None = None
    memory: str | None = None
    """Such as 16GB."""
    walltime: str | None = None
    """Such as 04:00:00."""


@dataclass(frozen=True)
class Run:
    """Run every method on every pair in every setting, score it, write tables and figures.

    A second call continues: only what is missing is computed.
    """

    config: tyro.conf.Positional[Path]
    """A TOML file (docs/experiments.md), or the name of one that comes with the package: main,
    ablation, sensitivity, geometry, runtime."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder of the experiment; experiments/<name> if left out."""
    store: Path | None = None
    """Folder for what methods and experiments share; `store` beside the experiment if left out."""
    methods: tuple[str, ...] = ()
    """Only these methods."""
    scenes: tuple[str, ...] = ()
    """Only these pairs."""
    limit: int | None = None
    """Only the first so many pairs of each benchmark."""
    data: dict[str, Path] = field(default_factory=dict)
    """Benchmark and its folder, instead of the one in the configuration: synthetic pairs/val."""
    jobs: int = 1
    """Processes at a time, which share the cores and the memory; with --slurm, Slurm jobs."""
    memory_gib: float | None = None
    """Memory that one process may take; an equal share of nine tenths of all if left out."""
    scheduler: str | None = None
    """Address of a dask scheduler whose workers do the work: tcp://host:port."""
    slurm: bool = False
    """Start workers as Slurm jobs."""
    slurm_options: SlurmOptions = field(default_factory=SlurmOptions)
    retry: bool = False
    """Try cells again that failed."""
    rescore: bool = False
    """Judge all answers again, and write all tables and figures anew."""

    def __call__(self) -> None:
        """Run, and say what was found."""
        if self.jobs < 1 or (self.memory_gib is not None and self.memory_gib <= 0):
            raise InputError("--jobs must be at least 1, and --memory-gib above 0.")
        if self.slurm and self.scheduler is not None:
            raise InputError("Give --scheduler or --slurm, not both.")
        config = self._config()
        run = Path("experiments", config.name) if self.out is None else self.out
        store = run.resolve().parent / "store" if self.store is None else self.store
        show = Show()
        with _ended_gently():
            report = run_experiment(
                config, run, store, lambda show: self._workers(show, run), show,
                retry=self.retry, rescore=self.rescore,
            command=("scenediff-experiments", *sys.argv[1:]),
            )  # fmt: skip
        _say(report)

    def _config(self) -> ExperimentConfig:
        config = read_config(self.config).selected(self.methods, self.scenes, self.limit)
        kinds = [b.kind for b in config.benchmarks]
        for kind in self.data:
            if kind not in kinds:
                raise InputError(
                    f"--data: there is no benchmark '{kind}', only {', '.join(kinds)}."
                )
        return replace(
            config,
            benchmarks=tuple(
                replace(b, root=self.data.get(b.kind, b.root)) for b in config.benchmarks
            ),
        )

    @contextmanager
    def _workers(self, show: Show, run: Path) -> Iterator[Workers]:
        if self.scheduler is None and not self.slurm:
            from baselines.experiments.workers import LocalWorkers

            memory = None if self.memory_gib is None else int(self.memory_gib * 2**30)
            with LocalWorkers(self.jobs, memory, run.resolve() / "log.txt", show.heard) as local:
                yield local
            return
        from baselines.experiments.cluster import ClusterWorkers, slurm_cluster

        options = vars(self.slurm_options)
        where = self.scheduler if self.scheduler else slurm_cluster(self.jobs, **options)
        try:
            with ClusterWorkers(where) as others:
                yield others
        finally:
            if not isinstance(where, str):
                where.close()


@dataclass(frozen=True)
class Compare:
    """Say how the second run differs from the first, with intervals, and on which pairs."""

    first: tyro.conf.Positional[Path]
    """Folder of an experiment."""
    second: tyro.conf.Positional[Path]
    """Folder of another one with methods, settings and pairs in common."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for compare.json."""

    def __call__(self) -> None:
        """Print the tables, and write the file if asked."""
        found = compare(self.first, self.second, Show().judging)
        for table in compared_tables(found):
            OUT.print(table)
        if self.out is not None:
            content = as_json(found, self.first, self.second)
            path = self.out / "compare.json"
            write_atomic(path, json.dumps(content, indent=1) + "\n")
            OUT.print(f"Wrote {shown(path)}", soft_wrap=True)


@contextmanager
def _ended_gently() -> Iterator[None]:
    """Take the system's request to end (SIGTERM, as batch systems send it) for Ctrl-C."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before if before is not None else signal.SIG_DFL)


def _say(report: Report) -> None:
    for table in headline(report.run):
        OUT.print(table)
    failed = f", {report.failed} failed" if report.failed else ""
    new = f"{report.computed} of them now" if report.computed else "all were there"
    OUT.print(f"{report.cells} cells, {new}{failed}: {shown(report.run)}", soft_wrap=True)
    if report.written:
        OUT.print(f"Open {shown(report.written[0])}", soft_wrap=True)


def main(arguments: list[str] | None = None) -> int:
    """Entry point of ``scenediff-experiments``; exit codes as of `run_command`."""
    return run_command(
        lambda: tyro.extras.subcommand_cli_from_dict(
            {"run": Run, "compare": Compare},
            prog="scenediff-experiments",
            description="Compare change detectors on the same pairs, frames and geometry.",
            args=arguments,
        )()
    )


if __name__ == "__main__":
    sys.exit(main())
