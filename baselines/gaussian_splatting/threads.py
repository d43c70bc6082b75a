"""Compiled kernels on all cores: each thread takes blocks of tiles or of Gaussians.

numba's own parallel loops are not used: their bodies round differently in the process that compiles
them and in those that load them from the cache, and a resumed training would not end as an
uninterrupted one.
"""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache

import torch

TILES = 8
GAUSSIANS = 4096


def over_blocks(kernel: Callable[..., None], count: int, block: int, *arguments: object) -> None:
    """Call ``kernel(*arguments, first, last)`` for all blocks of `count` items.

    The kernel must release the interpreter's lock and write to its own items only.
    """
    threads = thread_count()
    starts = range(0, count, block)
    if threads == 1 or len(starts) < 2:
        kernel(*arguments, 0, count)
        return
    done = [_pool(threads).submit(kernel, *arguments, s, min(s + block, count)) for s in starts]
    for part in done:
        part.result()


def thread_count() -> int:
    """As many threads as numba would use; asking numba itself would start OpenMP's as well."""
    return int(os.environ.get("NUMBA_NUM_THREADS", 0)) or os.cpu_count() or 1


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Keep PyTorch from sharing its small operations out among threads.

    They take less time than waking a thread does: on a busy computer, threads that spin while they
    wait for each other made an iteration six times as costly.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads)
