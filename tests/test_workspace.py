"""Files are whole or absent, and every failure to write says what to do."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from scenediff_classic.errors import OutputError
from scenediff_classic.workspace import load_npz, replacing, save_npz, write_atomic, writing


def test_text_and_bytes_arrive_and_leave_no_temporary_file(tmp_path: Path) -> None:
    write_atomic(tmp_path / "new" / "a.txt", "grün")
    write_atomic(tmp_path / "new" / "b.bin", b"\0\1")
    write_atomic(tmp_path / "new" / "b.bin", b"\2")
    assert (tmp_path / "new" / "a.txt").read_bytes() == "grün".encode()
    assert (tmp_path / "new" / "b.bin").read_bytes() == b"\2"
    assert sorted(os.listdir(tmp_path / "new")) == ["a.txt", "b.bin"]


def test_names_that_are_no_unicode_can_be_written(tmp_path: Path) -> None:
    write_atomic(tmp_path / "a.txt", os.fsdecode(b"\xff.png"))
    assert (tmp_path / "a.txt").read_text() == "\\udcff.png"


def test_a_failure_half_way_keeps_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def fail_half_way() -> None:
        with replacing(path) as file:
            file.write(b"new")
            raise KeyError("half way")

    with pytest.raises(KeyError):
        fail_half_way()
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


@pytest.mark.parametrize(
    ("number", "message"),
    [
        (errno.ENOSPC, "the disk is full; free some space"),
        (errno.EDQUOT, "the disk quota is used up"),
        (errno.EACCES, "no permission"),
        (errno.EROFS, "read-only"),
        (errno.EIO, "Input/output error"),
    ],
)
def test_system_errors_become_sentences(tmp_path: Path, number: int, message: str) -> None:
    with (
        pytest.raises(OutputError, match=rf"a\.txt cannot be written: .*{message}"),
        writing(tmp_path / "a.txt"),
    ):
        raise OSError(number, os.strerror(number))


def test_a_full_disk_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.npz"
    save_npz(path, a=np.arange(3))

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match=r"a\.npz cannot be written: the disk is full"):
        save_npz(path, a=np.arange(4))
    stored = load_npz(path)
    assert stored is not None
    assert len(stored["a"]) == 3
    assert os.listdir(tmp_path) == ["a.npz"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_device_that_is_full_is_reported(tmp_path: Path) -> None:
    (tmp_path / ".a.txt.tmp").symlink_to("/dev/full")
    with pytest.raises(OutputError, match=r"a\.txt cannot be written: the disk is full"):
        write_atomic(tmp_path / "a.txt", "x" * 100_000)
    assert os.listdir(tmp_path) == []


def test_folders_and_files_in_the_way_are_reported(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="folder cannot be written"):
        write_atomic(tmp_path / "folder", "x")
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"file/a\.txt cannot be written"):
        write_atomic(tmp_path / "file" / "a.txt", "x")


def test_arrays_come_back_exactly(tmp_path: Path) -> None:
    depth = np.array([[1.5, np.nan]], np.float32)
    save_npz(tmp_path / "a.npz", depth=depth, valid=np.isfinite(depth), count=np.array(3))
    stored = load_npz(tmp_path / "a.npz")
    assert stored is not None
    np.testing.assert_array_equal(stored["depth"], depth)
    assert stored["depth"].dtype == np.float32
    assert stored["valid"].tolist() == [[True, False]]
    assert stored["count"] == 3


def test_missing_and_damaged_arrays_are_absent(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    assert load_npz(path) is None
    save_npz(path, a=np.random.default_rng(0).random(50), b=np.zeros(50))
    data = path.read_bytes()
    for length in range(0, len(data), 17):
        path.write_bytes(data[:length])
        assert load_npz(path) is None
    rng = np.random.default_rng(0)
    for _ in range(100):
        damaged = bytearray(data)
        damaged[rng.integers(len(data))] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        stored = load_npz(path)  # names and dates are not covered by a checksum, values are
        assert stored is None or all(a.shape == (50,) for a in stored.values())


def test_pickled_objects_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", a=np.array([{"x": 1}], dtype=object))
    assert load_npz(tmp_path / "a.npz") is None
