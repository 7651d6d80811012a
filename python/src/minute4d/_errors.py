"""The one exception of this package, and its categories."""

from __future__ import annotations

import enum


class Category(enum.IntEnum):
    """Why a command failed; the values are the exit codes of the program."""

    INTERNAL = 1
    """A bug in minute4d."""
    USAGE = 2
    """An argument is invalid."""
    BAD_INPUT = 65
    """An input is damaged, incomplete or inconsistent."""
    NO_INPUT = 66
    """An input does not exist."""
    NO_DEVICE = 69
    """A device, decoder or weights are missing or fail, or memory is insufficient."""
    CANNOT_WRITE = 73
    """An output cannot be written."""
    IO = 74
    """The machine failed while reading."""
    TRY_AGAIN = 75
    """The same command may succeed later."""
    BAD_SETTINGS = 78
    """A setting does not exist or has an invalid value."""
    STOPPED = 130
    """The program was asked to stop; what was finished is kept."""
    KILLED = 137
    """The program ended without a report, as when the system kills it for want of memory."""

    @classmethod
    def of_exit_code(cls, code: int) -> Category:
        """Return the category of an exit code of the program."""
        if code == 143:
            return cls.STOPPED
        try:
            return cls(code)
        except ValueError:
            return cls.INTERNAL


class Minute4dError(Exception):
    """A command of the program failed, or its results cannot be read.

    ``category`` says why, ``message`` is one line with what was wrong, where, and what to do.
    """

    def __init__(self, category: Category, message: str) -> None:
        super().__init__(message)
        self.category = category
        self.message = message
