"""COLMAP behind plain values: the only modules that import pycolmap.

Everything that leaves this package is a NumPy array or one of the project's frozen dataclasses, so
that the rest never meets COLMAP's mutable objects, its ids or its logging.
"""

import signal
import threading

# pycolmap's wheel exports zlib symbols of its own: whoever loads it before Python's zlib makes the
# process abort when zlib is next flushed. Importing zlib first is enough.
import zlib  # noqa: F401

# It also takes the signals below for its own stack trace: a plain `kill` prints pages of C++, and
# after a crash the trace itself can wait for ever for a lock that the crash left closed.
_TAKEN = ("SIGSEGV", "SIGILL", "SIGFPE", "SIGABRT", "SIGBUS", "SIGTERM")
_before = {
    number: signal.getsignal(number)
    for number in (getattr(signal, name) for name in _TAKEN if hasattr(signal, name))
}

import pycolmap  # noqa: E402

if threading.current_thread() is threading.main_thread():  # no other may set handlers
    for _number, _handler in _before.items():
        signal.signal(_number, _handler if _handler is not None else signal.SIG_DFL)

pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value

VERSION: str = pycolmap.__version__
