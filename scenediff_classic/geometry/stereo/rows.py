"""Compiled kernels on all cores: each thread takes blocks of picture rows.

numba's own parallel loops are not used. It compiles their bodies twice, once for the process that
compiles and once for its cache, and the two round differently: the first run would differ from the
second.
"""

import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba
from numba.core.errors import NumbaWarning

BLOCK = 12
"""Rows a thread takes at a time: enough blocks to keep all of them busy."""


def over_rows(kernel: Callable[..., None], height: int, *arguments: object) -> None:
    """Call ``kernel(*arguments, first, last)`` for all blocks of rows.

    The kernel must release the interpreter's lock and write to its own rows only. As many threads
    as numba would use (``NUMBA_NUM_THREADS``).
    """
    starts = range(0, height, BLOCK)
    with ThreadPoolExecutor(_threads()) as pool:
        done = [pool.submit(kernel, *arguments, s, min(s + BLOCK, height)) for s in starts]
        for block in done:
            block.result()


def _threads() -> int:
    with warnings.catch_warnings():
        # of an old TBB that another library has loaded: numba's own threads are not used
        warnings.simplefilter("ignore", NumbaWarning)
        return numba.get_num_threads()
