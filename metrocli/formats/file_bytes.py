"""The bytes of a file, read once: what is hashed is what is used."""

from __future__ import annotations

import hashlib
import os
import stat
from functools import cached_property
from pathlib import Path

from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass

MOST_BYTES = 1 << 30
"""Largest file that is read whole, unless its format has a smaller limit"""


@dataclass(frozen=True)
class FileBytes:
    """The content of a file at one moment."""

    path: Path
    data: bytes

    @cached_property
    def sha256(self) -> str:
        """The SHA-256 of the content, hexadecimal."""
        return hashlib.sha256(self.data).hexdigest()


def read_bytes(path: Path, what: str = "a file", shown: str = "", most: int = MOST_BYTES) -> FileBytes:
    """Return the content of a regular file.

    `what` names the expected kind of file in messages. Raises InputError for a folder, a pipe or device (they may
    have no end), a file that cannot be opened, and one with more than `most` bytes.
    """
    shown = shown or str(path)
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except OSError as error:
        missing = isinstance(error, FileNotFoundError)
        message = "there is no such file" if missing else f"cannot be read: {error.strerror}"
        raise InputError([Fault(message, shown)]) from error
    try:
        found = os.fstat(handle)
        if stat.S_ISDIR(found.st_mode):
            raise InputError([Fault(f"this is a folder, not {what}", shown)])
        if not stat.S_ISREG(found.st_mode):
            raise InputError([Fault(f"this is a pipe or a device, not {what}", shown)])
        if found.st_size > most:
            raise InputError([Fault(f"the file has {found.st_size} bytes; {what} has at most {most}", shown)])
        with open(handle, "rb", closefd=False) as file:
            # not `most` at once: the buffer is taken as large as asked for, which a limit on memory may forbid
            data = file.read(found.st_size + 1)
            if len(data) > found.st_size:
                data += file.read(most + 1 - len(data))
    except OSError as error:
        raise InputError([Fault(f"cannot be read: {error.strerror}", shown)]) from error
    finally:
        os.close(handle)
    if len(data) > most:
        raise InputError([Fault(f"the file grew beyond {most} bytes while it was read", shown)])
    return FileBytes(path, data)
