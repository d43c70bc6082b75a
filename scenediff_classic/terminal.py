"""What every command says on the terminal: progress bars, the outcome, errors and exit codes."""

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from scenediff_classic.errors import SceneDiffError
from scenediff_classic.protocols import Progress
from scenediff_classic.report.page import verdict
from scenediff_classic.result.reading import read_result
from scenediff_classic.types import ChangeResult

OUT = Console()
ERR = Console(stderr=True)


def run_command(command: Callable[[], None]) -> int:
    """Run it; exit code 0 = done, 2 = input or set-up is at fault, 130 = interrupted."""
    try:
        command()
    except SceneDiffError as error:
        ERR.print(f"[red]Error:[/red] {shown(error)}", soft_wrap=True, highlight=False)
        return 2
    except KeyboardInterrupt:
        ERR.print("Interrupted. The same call continues where this one stopped.")
        return 130
    except BrokenPipeError:  # whoever read our output has seen enough, as in `--help | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the exit flushes it again
        return 1
    return 0


def print_outcome(result: ChangeResult | None, out: Path) -> None:
    """Say what was found and where to look.

    Parameters
    ----------
    result : ChangeResult or None
        From `run_detection`; None = `out` held this very result already.
    """
    if result is None:
        OUT.print(f"{shown(out)} holds this very result already: nothing to do.", soft_wrap=True)
        result = read_result(out / "changes.json")
    print_notes(result.warnings)
    OUT.print(f"[bold]{verdict(result)}[/bold]")
    OUT.print(f"Open {shown(out / 'report.html')}", soft_wrap=True)


def print_notes(notes: Iterable[str]) -> None:
    """Warnings, on the error stream."""
    for note in notes:
        ERR.print(f"[yellow]Note:[/yellow] {shown(note)}", soft_wrap=True, highlight=False)


def shown(value: object) -> str:
    """Text as it is: brackets are no markup, and names of files need not be valid Unicode."""
    return escape(str(value).encode(errors="backslashreplace").decode())


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """One bar per stage, on the error stream."""
    columns = (
        TextColumn("{task.description:<14}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    )  # fmt: skip
    with Bars(*columns, console=ERR) as bars:
        tasks = {}

        def report(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                if tasks:  # stages follow each other: only the latest is still running
                    bars.stop_task(list(tasks.values())[-1])
                tasks[stage] = bars.add_task(shown(stage), total=total or None)
            bars.update(tasks[stage], completed=done, total=total or None)

        yield report
