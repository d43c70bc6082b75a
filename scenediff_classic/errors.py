"""Errors that a user can act on.

Every message is one or two plain sentences: what is wrong, with which file, and what to do.
The command line prints it without a traceback and exits with 2.
"""


class SceneDiffError(Exception):
    """Base of every error that is the input's or the set-up's fault, not the program's."""


class InputError(SceneDiffError):
    """A file or folder that was given cannot be used."""


class AlignmentError(SceneDiffError):
    """The two captures could not be brought into one world frame."""


class OutputError(SceneDiffError):
    """The result cannot be written where it was asked for."""
