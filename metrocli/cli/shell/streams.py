"""Streams and folders that are not there: a closed stdout, a full disk behind it, a working folder that was removed."""

from __future__ import annotations

import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

UNWRITABLE = 3
"""Exit code where the output cannot be written, or the working folder is gone"""
_GONE = "error: the working folder no longer exists: change to another one (cd)\n"


def opened() -> None:
    """Open the null device for standard streams that the caller closed.

    A file opened later would otherwise take the number of the stream, and what is printed would be written into it.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    # kept open as long as the process runs
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115


def guarded(command: Callable[[], int]) -> int:
    """Return the exit code of a command, 3 if its output cannot be written or the working folder is gone."""
    opened()
    try:
        os.getcwd()
    except OSError:
        _to_stderr(_GONE)
        return UNWRITABLE
    try:
        code = command()
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        _to_stderr(f"error: the output cannot be written: {error.strerror}\n")
        code = UNWRITABLE
        _discard(1)
    try:
        sys.stderr.flush()
    except OSError:
        _discard(2)
    return code


def _to_stderr(text: str) -> None:
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except OSError:
        _discard(2)


def _discard(number: int) -> None:
    """Let what a stream still holds go to the null device: Python would fail to write it as it ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), number)
