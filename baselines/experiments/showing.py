"""What a running experiment says on the terminal."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from threading import Lock

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from baselines.experiments.tasks import Outcome, Prepare, Task
from scenediff_classic.terminal import ERR, print_notes, shown

_DAY = 24 * 3600.0


class Show:
    """Progress of all cells with the time left, a line for every one that runs, and what failed."""

    def __init__(self) -> None:
        """Nothing runs yet."""
        self._bars: Progress | None = None
        self._total: TaskID | None = None
        self._lines: dict[str, TaskID] = {}
        self._lock = Lock()

    @contextmanager
    def bars(self, cells: int) -> Iterator[None]:
        """Show the progress of so many cells."""
        columns = (
            TextColumn("{task.description}"), BarColumn(bar_width=20), MofNCompleteColumn(),
            TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
        )  # fmt: skip
        # cells take minutes: the speed is that of the whole run, not of its last seconds
        with Progress(*columns, console=ERR, speed_estimate_period=_DAY) as bars:
            self._bars, self._total = bars, bars.add_task("cells", total=cells)
            try:
                yield
            finally:
                self._bars, self._lines = None, {}

    def heard(self, task: Task, stage: str, done: int, total: int) -> None:
        """A worker says how far it is."""
        with self._lock:
            if self._bars is None:
                return
            if task.label not in self._lines:
                self._lines[task.label] = self._bars.add_task("", total=None)
            self._bars.update(
                self._lines[task.label], description=shown(f"  {task.label}: {stage}"),
                completed=done, total=total or None,
            )  # fmt: skip

    def finished(self, task: Task, outcome: Outcome) -> None:
        """A task ended."""
        with self._lock:
            if self._bars is None or self._total is None:
                return
            line = self._lines.pop(task.label, None)
            if line is not None:
                self._bars.remove_task(line)
            if outcome.status == "failed" and not isinstance(task, Prepare):
                self._bars.console.print(
                    f"[yellow]{shown(task.label)} failed:[/yellow] {shown(outcome.reason)}",
                    soft_wrap=True, highlight=False,
                )  # fmt: skip
            if not isinstance(task, Prepare):
                self._bars.advance(self._total)

    def judging(self, what: str) -> None:
        """Answers are being scored."""
        if ERR.is_terminal:
            ERR.print(f"Scoring {shown(what)}", highlight=False)

    def notes(self, notes: Iterable[str]) -> None:
        """What is wrong with a benchmark, which is no reason to stop."""
        print_notes(notes)
