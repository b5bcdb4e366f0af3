"""stdout and stderr that may be closed, full, or read by someone who has seen enough: a command does its work all the same."""

import os
import sys
from collections.abc import Callable
from typing import Any


class Outlet:
    """A stream whose failure is kept for the end instead of raised where something is printed."""

    def __init__(self, stream: Any) -> None:
        self.stream = stream
        self.failure: OSError | None = None

    def write(self, text: str) -> int:
        self._try(self.stream.write, text)
        return len(text)

    def flush(self) -> None:
        self._try(self.stream.flush)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def _try(self, action: Callable[..., Any], *arguments: str) -> None:
        try:
            action(*arguments)
        except OSError as error:
            if not isinstance(error, BrokenPipeError):  # `| head` is no failure
                self.failure = error
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.stream.fileno())  # for what it still holds, and for what follows
            os.close(nowhere)


def guard_streams() -> None:
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:  # closed: a file that is opened later would take its place, and be printed into
            os.open(os.devnull, os.O_RDWR)
    sys.stdout, sys.stderr = (stream and Outlet(stream) for stream in (sys.stdout, sys.stderr))


def exit_code(code: int) -> int:
    """Of a command that has ended so: 3 where its output could not be written."""
    if not isinstance(sys.stdout, Outlet):
        return code
    sys.stdout.flush()
    if sys.stdout.failure is None:
        return code
    print(f"stdout: {sys.stdout.failure.strerror}; not all of the output was written", file=sys.stderr)
    return code or 3
