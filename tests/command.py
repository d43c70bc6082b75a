"""Runs the command line in this process, and renders a pair of captures for it, once."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import pytest

from scenediff_classic.cli import main


@dataclass(frozen=True)
class Outcome:
    """What a user sees of a call."""

    code: int
    out: str
    err: str

    @property
    def complaint(self) -> str:
        """The sentence after ``Error:``; fails if there is not exactly one."""
        assert self.code == 2, self.err
        assert "Traceback" not in self.out + self.err
        sentences = [line for line in self.err.splitlines() if line.startswith("Error: ")]
        assert len(sentences) == 1, self.err
        return sentences[0].removeprefix("Error: ")


Call = Callable[..., Outcome]


def caller(capsys: pytest.CaptureFixture[str]) -> Call:
    """A function that calls ``scenediff-classic`` with the given arguments."""

    def call(*arguments: str | Path) -> Outcome:
        capsys.readouterr()
        code = 0
        with patch.object(sys, "argv", ["scenediff-classic", *map(str, arguments)]):
            try:
                main()
            except SystemExit as stop:
                code = stop.code if isinstance(stop.code, int) else 1
        shown = capsys.readouterr()
        return Outcome(code, shown.out, shown.err)

    return call


def names(folder: Path) -> Sequence[str]:
    """Everything directly in a folder, hidden things too."""
    return sorted(p.name for p in folder.iterdir())
