"""Does what is left to do: geometry before the methods that need it, whoever works."""

from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Protocol

from baselines.experiments.tasks import Detect, Outcome, Prepare, Task, write_outcome

Finished = Callable[[Task, Outcome], None]


class Workers(Protocol):
    """Whoever does tasks."""

    slots: int
    """How many tasks they can be given at a time."""

    def submit(self, task: Task) -> "Future[Outcome]":
        """Do a task."""
        ...


def drive(tasks: Iterable[Detect], workers: Workers, finished: Finished) -> None:
    """Do all tasks; whatever goes wrong with one is its outcome, which is kept in its record.

    Parameters
    ----------
    finished
        Called after every task, those that prepare geometry included.
    """
    waiting: dict[str, list[Detect]] = {}
    prepares: dict[str, Prepare] = {}
    for task in tasks:
        waiting.setdefault(task.prepare.key, []).append(task)
        prepares.setdefault(task.prepare.key, task.prepare)
    ready: list[Task] = list(reversed(prepares.values()))  # the last one is the next
    running: dict[Future[Outcome], Task] = {}
    try:
        while ready or running:
            while ready and len(running) < workers.slots:
                task = ready.pop()
                running[workers.submit(task)] = task
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                task = running.pop(future)
                outcome = _outcome(future)
                if isinstance(task, Prepare):
                    finished(task, outcome)
                    followers = waiting.pop(task.key)
                    if outcome.status == "done":
                        ready += reversed(followers)  # before the geometry of further pairs
                        continue
                    for follower in followers:
                        _failed(follower, outcome, finished)
                elif outcome.status == "failed":
                    _failed(task, outcome, finished)
                else:
                    finished(task, outcome)
    finally:
        for future in running:
            future.cancel()


def _failed(task: Detect, outcome: Outcome, finished: Finished) -> None:
    write_outcome(task, outcome)
    finished(task, outcome)


def _outcome(future: "Future[Outcome]") -> Outcome:
    try:
        return future.result()
    except Exception as error:  # of the workers, not of the task: lost too often, say
        words = " ".join(str(error).split())
        return Outcome("failed", f"Its worker was lost: {type(error).__name__}: {words}", False)
