"""The life cycle of an output folder.

A run works in a hidden folder beside OUT, which becomes OUT by one rename when all is done. So
OUT never holds half a result, and a killed run leaves behind what the next one continues from.
"""

import errno
import fcntl
import json
import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenediff_classic.errors import OutputError
from scenediff_classic.workspace import write_atomic, writing

MARKER = "run.json"
"""The file that makes a folder recognisable as a run's; no other folder is ever deleted."""

_UNFINISHED = ".unfinished.json"  # the same, while the run is under way
_SCRATCH = ".scratch"


@dataclass(frozen=True)
class Run:
    """An output folder in the making; use it as a context manager, which frees it for others."""

    out: Path
    """Where the result will be, or already is."""
    folder: Path
    """Where to write until `finish`; `out` itself if `already_done`."""
    fingerprint: Mapping[str, Any]
    already_done: bool = False
    resumed: bool = False
    """Whether `folder` holds the finished stages of an earlier, killed run."""
    lock: int | None = None
    """File descriptor of the locked folder."""

    @property
    def scratch(self) -> Path:
        """Folder for what later stages or a resumed run need, but not the result."""
        return self.folder / _SCRATCH

    def finish(self) -> None:
        """Turn `folder` into `out`, without `scratch`, replacing the run that `out` may hold.

        ``run.json`` is completed with the fingerprint, and written if it is missing.

        Raises
        ------
        OutputError
            If `out` cannot be replaced; `folder` is then kept for the next call.
        """
        if self.already_done:
            return
        document = _read_json(self.folder / MARKER) or {"schema": 1}
        document["fingerprint"] = self.fingerprint
        text = json.dumps(document, indent=2)  # ASCII: names need not be valid Unicode
        write_atomic(self.folder / MARKER, text + "\n")
        replaced = _beside(self.out, "replaced")
        _discard(replaced)
        with writing(self.out):
            if _fingerprint_in(self.out / MARKER) is not None:
                self.out.rename(replaced)
            self.folder.rename(self.out)
            _flush_folder(self.out.parent)
        _remove_leftovers(self.out)
        with suppress(OutputError):
            _discard(replaced)

    def close(self) -> None:
        """Free the folder for other runs; a folder in which nothing was finished is removed."""
        if self.lock is None:
            return
        try:
            with suppress(OSError):
                if not os.path.samestat(os.fstat(self.lock), self.folder.stat()):
                    return  # finished, and by now perhaps another run's
                with suppress(OSError):
                    self.scratch.rmdir()  # if it is empty
                if {p.name for p in self.folder.iterdir()} <= {_UNFINISHED}:
                    _empty(self.folder)
                    self.folder.rmdir()
        finally:
            os.close(self.lock)

    def __enter__(self) -> "Run":
        """Nothing is left to do: `open_run` holds the lock already."""
        return self

    def __exit__(self, *_: object) -> None:
        """See `close`."""
        self.close()


def open_run(out: Path, fingerprint: Mapping[str, Any], overwrite: bool = False) -> Run:
    """Begin, continue or recognise the run that makes `out`.

    Parameters
    ----------
    fingerprint : mapping
        Everything that decides what the result is (inputs, options, versions), as plain JSON
        values. A killed run with the same fingerprint is continued, another one discarded.
    overwrite : bool
        Replace the run that `out` holds, once the new one is finished. Folders that are not a
        run's are never touched.

    Returns
    -------
    Run
        To be closed, best by ``with``. If `Run.already_done`, nothing has to be computed.

    Raises
    ------
    OutputError
        If `out` holds something else, cannot be written, or is being written by another run.
    """
    fingerprint = json.loads(json.dumps(fingerprint, allow_nan=False))
    out = _resolved(out)
    if _is_done(out, fingerprint, overwrite):
        return Run(out, out, fingerprint, already_done=True)
    partial = _beside(out, "partial")
    with writing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        lock = _claim(partial, out)
    try:
        # Another run may have finished between the first look and the lock.
        if _is_done(out, fingerprint, overwrite):
            Run(out, partial, fingerprint, lock=lock).close()
            return Run(out, out, fingerprint, already_done=True)
        resumed = _prepare(partial, fingerprint)
    except BaseException:
        Run(out, partial, fingerprint, lock=lock).close()
        raise
    return Run(out, partial, fingerprint, resumed=resumed, lock=lock)


def _resolved(out: Path) -> Path:
    """The real folder behind links, so that the hidden folder lies on the same disk."""
    with writing(out):
        try:
            return out.resolve()
        except RuntimeError as error:  # Python before 3.13, on a loop of links
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP)) from error


def _beside(out: Path, role: str) -> Path:
    return out.with_name(f".{out.name}.{role}")


def _is_done(out: Path, fingerprint: Mapping[str, Any], overwrite: bool) -> bool:
    """Whether `out` holds the wanted result; an error if it holds anything else."""
    with writing(out):
        if out.is_mount() or out == Path.cwd():
            raise OutputError(
                f"{out} cannot be replaced as a whole (it is the current folder or the root of a "
                f"disk): choose a folder inside it, such as {out / 'result'}."
            )
        if not out.exists():
            return False
        if not out.is_dir():
            raise OutputError(f"{out} is a file: choose the name of a new folder.")
        entries = sorted(p.name for p in out.iterdir())
    if not entries:
        return False
    found = _fingerprint_in(out / MARKER)
    if found is None:
        raise OutputError(
            f"{out} holds other files ({entries[0]}), which are left alone: choose another folder."
        )
    if overwrite:
        return False
    if found == fingerprint:
        _remove_leftovers(out)
        return True
    raise OutputError(
        f"{out} holds another run, of other inputs or options: choose another folder, or pass "
        "--overwrite to replace it."
    )


def _claim(partial: Path, out: Path) -> int:
    """Lock the hidden folder, making it first; the kernel frees the lock of a killed run."""
    while True:
        partial.mkdir(exist_ok=True)
        try:
            lock = os.open(partial, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except FileNotFoundError:
            continue  # another run has just finished with it
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            os.close(lock)
            raise OutputError(
                f"Another run is writing to {out} now: wait for it, or choose another folder."
            ) from error
        except OSError:  # some network drives have no locks: better to go on without than not
            return lock
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(lock), os.stat(partial)):
                return lock
        os.close(lock)  # what we opened was finished or removed by another run meanwhile


def _prepare(partial: Path, fingerprint: Mapping[str, Any]) -> bool:
    """Make the claimed folder ready; whether it holds work to continue from."""
    # A run's own run.json, written last, may not know the fingerprint yet: it counts second.
    found = _fingerprint_in(partial / _UNFINISHED) or _fingerprint_in(partial / MARKER)
    with writing(partial):
        if found == fingerprint:
            for temporary in list(partial.rglob(".*.tmp")):
                temporary.unlink()
            return True
        if found is None and {p.name for p in partial.iterdir()} - {f".{_UNFINISHED}.tmp"}:
            raise _in_the_way(partial)
        _empty(partial)
    write_atomic(partial / _UNFINISHED, json.dumps({"schema": 1, "fingerprint": fingerprint}))
    return False


def _fingerprint_in(marker: Path) -> Mapping[str, Any] | None:
    """The fingerprint that a marker holds; None if the file is missing or no marker of ours."""
    document = _read_json(marker)
    if document and "schema" in document and isinstance(document.get("fingerprint"), dict):
        return document["fingerprint"]
    return None


def _read_json(path: Path) -> dict[str, Any] | None:
    try:
        document = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return document if isinstance(document, dict) else None


def _discard(folder: Path) -> None:
    """Delete the folder of an earlier run, and nothing else."""
    if not os.path.lexists(folder):
        return
    with writing(folder):
        if folder.is_symlink() or (
            _fingerprint_in(folder / MARKER) is None and any(folder.iterdir())
        ):
            raise _in_the_way(folder)
        _empty(folder)
        folder.rmdir()


def _in_the_way(folder: Path) -> OutputError:
    return OutputError(f"{folder} is in the way and is not an earlier run's: move it elsewhere.")


def _empty(folder: Path) -> None:
    """Delete what a run's folder holds; its markers last, so that it stays known as a run's."""
    order = {_UNFINISHED: 1, MARKER: 2}
    for path in sorted(folder.iterdir(), key=lambda p: order.get(p.name, 0)):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _remove_leftovers(out: Path) -> None:
    """Delete what only an unfinished run needs; failing at it does no harm."""
    shutil.rmtree(out / _SCRATCH, ignore_errors=True)
    with suppress(OSError):
        (out / _UNFINISHED).unlink(missing_ok=True)


def _flush_folder(folder: Path) -> None:
    """Make a rename last through a power cut."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
