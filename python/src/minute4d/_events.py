"""The events of the program (``minute4d --json``) as an iterator."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, TypedDict, Union, cast

from ._errors import Category, Minute4dError

SCHEMA = 1
"""Version of the events that this package understands."""


class StartEvent(TypedDict):
    """The first event."""

    event: Literal["start"]
    schema: int
    minute4d: str
    """Version of the program."""


class _StageEvent(TypedDict):
    event: Literal["stage"]
    stage: str
    """``geometry``, ``train``, ``preview`` or ``viewer``."""
    status: Literal["started", "resumed", "reused", "finished"]


class StageEvent(_StageEvent, total=False):
    """A stage began or ended; the other fields depend on the status."""

    because: Union[str, None]
    """``started``: why it is done again."""
    done: int
    total: int
    """``resumed``: steps."""
    seconds: float
    """``finished``: wall-clock seconds."""


class ProgressEvent(TypedDict):
    """A step of a phase; at most two per second and phase."""

    event: Literal["progress"]
    phase: str
    done: int
    total: int
    eta_s: Union[float, None]
    """Estimated seconds to the end of the phase."""
    note: str


class WarningEvent(TypedDict):
    """A warning about the result."""

    event: Literal["warning"]
    message: str


class ViewEvent(TypedDict):
    """The address of the page that shows the work (option ``view``)."""

    event: Literal["view"]
    url: str


class ResultEvent(TypedDict):
    """The result of the command; for ``run`` the output folder (``path``) and its ``record``."""

    event: Literal["result"]
    result: Any


Event = Union[StartEvent, StageEvent, ProgressEvent, WarningEvent, ViewEvent, ResultEvent]
"""An event; ``event["event"]`` tells which one."""


class Events(Iterator[Event]):
    """The events of a running program.

    The iterator ends when the program does, and raises `Minute4dError` if it failed. A program that
    is no longer listened to saves its state and stops: on ``close()``, at the end of a ``with``
    block, on Ctrl-C, when the iterator is deleted, and when this process ends in any way. The same
    command with ``resume=True`` continues it. A second Ctrl-C stops it without saving.
    """

    def __init__(self, program: Path, arguments: Sequence[str]) -> None:
        # A file, not a pipe: no thread has to read it while the program writes.
        self._messages = tempfile.TemporaryFile()
        self._ended = False
        self._result: Any = None
        # The program stops when its input ends. Signals of a terminal reach it without our help.
        self._process = subprocess.Popen(
            [str(program), "--json", "--stop-at-eof", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._messages,
        )

    def __iter__(self) -> Events:
        return self

    def __next__(self) -> Event:
        """Return the next event.

        Raises `StopIteration` after the last, `Minute4dError` if the program failed.
        """
        if self._ended:
            raise StopIteration
        try:
            event = self._read()
        except BaseException:
            self.close()
            raise
        if event is None:
            raise StopIteration
        return event

    def wait(self) -> Any:
        """Wait for the end of the program and return its result, as in `ResultEvent`.

        Raises `Minute4dError` if the program failed.
        """
        for _ in self:
            pass
        return self._result

    def close(self) -> None:
        """Ask the program to save its state and stop, and wait until it has.

        Does nothing if it has ended. Raises `Minute4dError` if its state could not be saved.
        """
        if self._ended:
            return
        self._end_input()
        assert self._process.stdout is not None
        try:
            # An interrupted read may have lost a part of a line, but never the last one.
            last = self._process.stdout.read().rstrip(b"\n").rpartition(b"\n")[2]
            code = self._process.wait()
        except BaseException:
            # Interrupted once more. Ctrl-C ends the program at once, too; other signals do not.
            self._process.kill()
            self._end()
            raise
        if code in (0, 130, 143):
            self._end()
            return
        error = self._killed()
        if last.startswith(b'{"event":"end"'):
            error = Minute4dError(Category.of_exit_code(code), json.loads(last)["reason"])
        raise error

    def __enter__(self) -> Events:
        return self

    def __exit__(
        self,
        kind: Union[type[BaseException], None],
        error: Union[BaseException, None],
        trace: Union[TracebackType, None],
    ) -> None:
        self.close()

    def __del__(self) -> None:
        # Without a process its start failed.
        if getattr(self, "_process", None) is not None:
            self.close()

    def _read(self) -> Union[Event, None]:
        """Return the next event, or None after the last."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.endswith(b"\n"):
            raise self._killed()
        event = json.loads(line)
        if event["event"] == "end":
            code = self._end()
            if event["code"] != 0 or code != 0:
                raise Minute4dError(Category.of_exit_code(code), event["reason"])
            return None
        if event["event"] == "start" and event["schema"] != SCHEMA:
            raise Minute4dError(
                Category.INTERNAL,
                f"the program has events of version {event['schema']}, not {SCHEMA}; "
                "install the package again",
            )
        if event["event"] == "result":
            self._result = event["result"]
        return cast(Event, event)

    def _killed(self) -> Minute4dError:
        """Return the error for a program that ended without its last event."""
        code = self._process.wait()
        self._messages.seek(0)
        lines = self._messages.read().decode(errors="replace").split("\n")
        text = " ".join(line.strip() for line in lines[-6:]).strip()
        self._end()
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        return Minute4dError(
            Category.KILLED, f"the program ended without a report ({how}): {text or 'no message'}"
        )

    def _end_input(self) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
        except BrokenPipeError:
            pass

    def _end(self) -> int:
        """Release what the ended program held, and return its exit code."""
        assert self._process.stdout is not None
        self._end_input()
        code = self._process.wait()
        self._process.stdout.close()
        self._messages.close()
        self._ended = True
        return code
