"""COLMAP behind plain values: the only modules that import pycolmap.

Everything that leaves this package is a NumPy array or one of the project's frozen dataclasses, so
that the rest never meets COLMAP's mutable objects, its ids or its logging.
"""

# pycolmap's wheel exports zlib symbols of its own: whoever loads it before Python's zlib makes the
# process abort when zlib is next flushed. Importing zlib first is enough.
import zlib  # noqa: F401

import pycolmap

pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value

VERSION: str = pycolmap.__version__
