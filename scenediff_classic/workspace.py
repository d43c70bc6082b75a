"""Safe writing: files that are whole or absent, and failures that say what to do."""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from scenediff_classic.errors import OutputError

_ADVICE = {
    errno.ENOSPC: "the disk is full; free some space and give the same command again",
    errno.EDQUOT: "the disk quota is used up; free some space and give the same command again",
    errno.EACCES: "there is no permission to write there; choose another folder",
    errno.EPERM: "there is no permission to write there; choose another folder",
    errno.EROFS: "that disk is read-only; choose another folder",
    errno.ENOTEMPTY: "something else was put there meanwhile; choose another folder",
}


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn every `OSError` inside into an `OutputError` that names `path` and says what to do."""
    try:
        yield
    except OSError as error:
        why = _ADVICE.get(error.errno or 0) or error.strerror or str(error)
        raise OutputError(f"{path} cannot be written: {why}.") from error


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A binary file that takes the place of `path` only once it is written completely.

    Missing folders above it are created. If the block raises, `path` stays as it was.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with temporary.open("wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(path)
        except BaseException:
            with suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise


def write_atomic(path: Path, content: bytes | str) -> None:
    """Write a whole file (text as UTF-8), or leave what was there; see `replacing`."""
    if isinstance(content, str):  # names of files need not be valid Unicode
        content = content.encode(errors="backslashreplace")
    with replacing(path) as file:
        file.write(content)


def save_npz(path: Path, *, compress: bool = True, **arrays: np.ndarray) -> None:
    """Write arrays as an ``.npz``, whole or not at all; see `replacing`."""
    write = np.savez_compressed if compress else np.savez
    with replacing(path) as file:
        write(file, **cast(dict[str, Any], arrays))


def load_npz(path: Path) -> dict[str, np.ndarray] | None:
    """The arrays of an ``.npz``; None where the file is missing or damaged."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except Exception:  # on damaged data zipfile, zlib and NumPy raise almost anything
        return None
