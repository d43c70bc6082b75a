"""Pickles from strangers: read without running anything that they name.

A pickle is a small program. Ours is allowed to build plain Python values only; NumPy's arrays
and scalars are rebuilt here, as lists and numbers, so that no code of NumPy's (which trusts what
it unpickles) sees the file. Every stand-in is an object without attributes: a pickle that tries
to change one fails.
"""

import pickle
import re
import reprlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from scenediff_classic.errors import InputError


def read_pickle(path: Path) -> Any:
    """Plain value of a pickle; NumPy arrays become nested lists (of no dimension: ``[value]``).

    Raises
    ------
    InputError
        The file is absent, damaged, or would build anything but containers, text, bytes,
        numbers and NumPy arrays of them.
    """
    return _read(path, lambda file: _PlainUnpickler(file).load())


def read_npy(path: Path) -> Any:
    """Array of a ``.npy`` file of numbers; plain value of one that holds pickled objects.

    Raises
    ------
    InputError
        As `read_pickle`; or the file is no array.
    """
    return _read(path, _npy)


def _npy(file: BinaryIO) -> Any:
    version = np.lib.format.read_magic(file)
    header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }[version]
    shape, column_major, dtype = header(file)
    if dtype == np.dtype(object):
        found = _ObjectUnpickler(file).load()
        return found if shape else found[0]
    if dtype.kind not in "biuf":
        raise _ForbiddenError(f"the NumPy type {str(dtype)[:40]}")
    values = np.frombuffer(file.read(), dtype)
    return values.reshape(shape, order="F" if column_major else "C")


def _read(path: Path, load: Callable[[BinaryIO], Any]) -> Any:
    try:
        with path.open("rb") as file:
            return load(file)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error}).") from error
    except _ForbiddenError as error:
        raise InputError(
            f"{path} was refused: it asks for {error}, but only plain values and NumPy arrays "
            "are read from a pickle, because a pickle can run any code."
        ) from error
    except Exception as error:  # a damaged pickle fails with almost any exception
        raise InputError(f"{path} is not a readable pickle: it is damaged or cut short.") from error


class _ForbiddenError(Exception):
    """The pickle names something outside the plain values."""


class _PlainUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        module = module.replace("numpy.core", "numpy._core").replace("__builtin__", "builtins")
        try:
            return _ALLOWED[module, name]
        except KeyError:
            raise _ForbiddenError(f"{module}.{name}"[:100]) from None


class _ObjectUnpickler(_PlainUnpickler):
    """Reads arrays of objects too, which are plain values again: for files that are known by
    their header to be such."""

    def find_class(self, module: str, name: str) -> Any:
        found = super().find_class(module, name)
        return _MakeAnyDtype() if isinstance(found, _MakeDtype) else found


class _ArrayClass:
    """Stands for ``numpy.ndarray`` where a pickle hands it on as an argument."""

    __slots__ = ()


class _Dtype:
    """A number type: kind, size and byte order, nothing else."""

    __slots__ = ("number",)

    def __init__(self, code: object) -> None:
        if not isinstance(code, str) or not re.fullmatch(r"[?]|[biuf][1248]", code):
            raise _ForbiddenError(f"the NumPy type {reprlib.repr(code)}")
        self.number = np.dtype(code)

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        if state[1] == ">":
            self.number = self.number.newbyteorder(">")

    def values(self, data: bytes) -> np.ndarray:
        return np.frombuffer(data, self.number)


class _ObjectDtype:
    """The type of arrays of objects, whose state holds them as a list."""

    __slots__ = ()

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        """Byte order and the like: nothing that objects have."""

    def values(self, data: list[Any]) -> np.ndarray:
        if type(data) is not list:
            raise _ForbiddenError("an array of objects that are no list")
        out = np.empty(len(data), object)
        for k, item in enumerate(data):
            out[k] = item
        return out


class _List(list):
    """An array under construction: NumPy's pickles fill it in a second step."""

    __slots__ = ()

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, dtype, column_major, data = state
        self[:] = _reshaped(dtype.values(data), shape, "F" if column_major else "C")


class _MakeDtype:
    __slots__ = ()

    def __call__(self, code: object, *_: object) -> _Dtype:
        return _Dtype(code)


class _MakeAnyDtype(_MakeDtype):
    __slots__ = ()

    def __call__(self, code: object, *_: object) -> Any:
        return _ObjectDtype() if code in ("O", "O8") else _Dtype(code)


class _MakeArray:
    __slots__ = ()

    def __call__(self, *_: object) -> _List:
        return _List()


class _MakeArrayFromBuffer:
    """The form that pickle protocol 5 uses."""

    __slots__ = ()

    def __call__(self, data: Any, dtype: _Dtype, shape: tuple[int, ...], order: Any) -> Any:
        return _reshaped(dtype.values(bytes(data)), shape, "F" if order == "F" else "C")


class _MakeScalar:
    __slots__ = ()

    def __call__(self, dtype: _Dtype, data: bytes | str) -> Any:
        return dtype.values(_latin_bytes(data))[0].item()


class _MakeBytes:
    """The form that the oldest protocols use for bytes."""

    __slots__ = ()

    def __call__(self, text: str = "", *_: object) -> bytes:
        return _latin_bytes(text)


def _latin_bytes(data: bytes | str) -> bytes:
    return data.encode("latin-1") if isinstance(data, str) else bytes(data)


def _reshaped(values: np.ndarray, shape: Any, order: Any) -> Any:
    return values.reshape(tuple(shape) or (1,), order=order).tolist()


_ALLOWED: dict[tuple[str, str], Any] = {
    ("builtins", "set"): set,
    ("builtins", "frozenset"): frozenset,
    ("builtins", "bytearray"): bytearray,
    ("builtins", "bytes"): _MakeBytes(),
    ("_codecs", "encode"): _MakeBytes(),
    ("numpy", "ndarray"): _ArrayClass(),
    ("numpy", "dtype"): _MakeDtype(),
    ("numpy._core.multiarray", "_reconstruct"): _MakeArray(),
    ("numpy._core.multiarray", "scalar"): _MakeScalar(),
    ("numpy._core.numeric", "_frombuffer"): _MakeArrayFromBuffer(),
}
