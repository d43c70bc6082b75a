"""Workers on this machine: a process of its own for every task.

So the memory of a task is given back when it ends, its peak is its own, and what kills it (the
system short of memory, a crash in compiled code) kills nothing else.
"""

import os
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import psutil

from baselines.experiments.tasks import Outcome, Task, perform

ATTEMPTS = 2
"""How often a task is tried whose process dies."""

_THREADS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS",
)  # fmt: skip

Heard = Callable[[Task, str, int, int], None]
"""Called as ``heard(task, stage, done, total)``, from any thread."""


class LocalWorkers:
    """Up to `jobs` processes at a time; use as a context manager."""

    def __init__(self, jobs: int, memory: int | None, log: Path, heard: Heard) -> None:
        """Share cores and memory out.

        Parameters
        ----------
        memory : int, optional
            Bytes that a process may take; an equal share of nine tenths of the machine's if None.
        log : Path
            File for whatever tasks print.
        """
        self.slots = jobs
        self._threads = max((os.cpu_count() or 1) // jobs, 1)
        self._memory = memory or int(0.9 * psutil.virtual_memory().total / jobs)
        self._log = log
        self._heard = heard
        self._stopped = threading.Event()
        self._pool = ThreadPoolExecutor(jobs, thread_name_prefix="worker")
        # forked from a process that has imported everything and started no threads
        self._context = get_context("forkserver")
        self._context.set_forkserver_preload(["baselines.experiments.tasks"])
        for name in _THREADS:
            os.environ[name] = str(self._bounded(name))

    def submit(self, task: Task) -> "Future[Outcome]":
        """Do a task as soon as a process is free."""
        return self._pool.submit(self._done, task)

    def __enter__(self) -> "LocalWorkers":
        """Processes are started when there is work."""
        return self

    def __exit__(self, *_: object) -> None:
        """End whatever still runs."""
        self._stopped.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def _bounded(self, name: str) -> int:
        asked = os.environ.get(name, "")
        return min(int(asked), self._threads) if asked.isdecimal() else self._threads

    def _done(self, task: Task) -> Outcome:
        ending = ""
        for _ in range(ATTEMPTS):
            outcome = self._attempt(task)
            if isinstance(outcome, Outcome):
                return outcome
            ending = outcome
        reason = f"Its process ended {ATTEMPTS} times without an answer ({ending})."
        return Outcome("failed", reason, final=False)

    def _attempt(self, task: Task) -> Outcome | str:
        """The outcome, or how the process died before it had one."""
        here, there = self._context.Pipe()
        environment = {name: str(self._bounded(name)) for name in _THREADS}
        process: Any = self._context.Process(
            target=_work, args=(there, environment, self._log, task), daemon=True
        )
        process.start()
        there.close()
        try:
            while not self._stopped.is_set():
                try:
                    if here.poll(0.5):
                        message = here.recv()
                        if isinstance(message, Outcome):
                            return message
                        self._heard(task, *message)
                        continue
                except (EOFError, OSError):
                    process.join()
                    return _ending(process.exitcode)
                if _memory_of(process.pid) > self._memory:
                    limit = self._memory / 2**30
                    reason = f"It took more than {limit:.1f} GiB of memory, a worker's limit."
                    return Outcome("failed", reason, final=False)
            return Outcome("failed", "It was interrupted.", final=False)
        finally:
            # it is left alone only after it had the time to tidy up its semaphores
            process.join(timeout=0 if self._stopped.is_set() else 5)
            here.close()
            if process.is_alive():
                process.kill()
                process.join()
            process.close()


def _ending(code: int | None) -> str:
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        return f"{name}, perhaps for want of memory" if name == "SIGKILL" else name
    return f"exit code {code}"


def _memory_of(pid: int) -> int:
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:
        return 0


def _work(connection: Connection, environment: dict[str, str], log: Path, task: Task) -> None:
    """What a process does: one task."""
    import cv2
    import numba.core.config
    import torch

    os.environ.update(environment)
    threads = int(environment["NUMBA_NUM_THREADS"])
    numba.core.config.reload_config()
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    printed = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (1, 2):
        os.dup2(printed, stream)
    threading.Thread(target=_until_left_alone, args=(connection,), daemon=True).start()
    said = 0.0

    def progress(stage: str, done: int, total: int) -> None:
        nonlocal said
        if time.monotonic() - said > 0.3:
            said = time.monotonic()
            connection.send((stage, done, total))

    connection.send(perform(task, progress))


def _until_left_alone(connection: Connection) -> None:
    """End with the process that asked for the work, however that one ends."""
    try:
        connection.recv()
    except (EOFError, OSError):
        os._exit(1)
