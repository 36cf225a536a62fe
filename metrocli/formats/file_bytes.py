"""Bytes of files: read once with their hash, and written aside before they take their name."""

from __future__ import annotations

import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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
        # O_NONBLOCK: opening a pipe that nobody writes to would wait for ever, before its kind is known
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except OSError as error:
        missing = isinstance(error, FileNotFoundError)
        message = "there is no such file" if missing else f"cannot be read: {error.strerror}"
        raise InputError([Fault(message, shown)]) from error
    try:
        status = os.fstat(handle)
        if stat.S_ISDIR(status.st_mode):
            raise InputError([Fault(f"this is a folder, not {what}", shown)])
        if not stat.S_ISREG(status.st_mode):
            raise InputError([Fault(f"this is a pipe or a device, not {what}", shown)])
        if status.st_size > most:
            raise InputError([Fault(f"the file has {status.st_size} bytes; {what} has at most {most}", shown)])
        with open(handle, "rb", closefd=False) as file:
            # not `most` at once: the buffer is taken as large as asked for, which a limit on memory may forbid
            # one byte more than the size, so that a file that grows meanwhile shows it
            data = file.read(status.st_size + 1)
            if len(data) > status.st_size:
                data += file.read(most + 1 - len(data))
    except OSError as error:
        raise InputError([Fault(f"cannot be read: {error.strerror}", shown)]) from error
    finally:
        os.close(handle)
    if len(data) > most:
        raise InputError([Fault(f"the file grew beyond {most} bytes while it was read", shown)])
    return FileBytes(path, data)


_open: set[Path] = set()
"""Temporary files that this process is writing"""


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder to write to; on success it replaces `path` in one step.

    The temporary file is locked as long as its writer lives, so that others can see which ones are left over. Raises
    InputError if the file cannot be written; `path` and the folders are then as before.
    """
    try:
        with folder_made(path.parent), _replacing(path) as temporary:
            yield temporary
    except OSError as error:
        raise InputError([Fault(f"cannot be written: {error.strerror or error}", str(path))]) from error


@contextmanager
def folder_made(folder: Path) -> Iterator[None]:
    """Make a folder, and those above it, if need be; of those that were made the empty ones go at the end."""
    # lexists: a link to nothing is there, and is not ours to remove
    absent = [parent for parent in (folder, *folder.parents) if not os.path.lexists(parent)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        with suppress(OSError):
            # innermost first; one that is not empty ends the loop, and those above it hold it
            for parent in absent:
                parent.rmdir()


@contextmanager
def _replacing(path: Path) -> Iterator[Path]:
    # in the same folder, since a rename is one step within a file system only
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    handle = -1
    try:
        sweep(path.parent, f".{path.name}.")
        _open.add(temporary)
        handle = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666)
        _lock(handle)
        yield temporary
        # before the rename: after a loss of power the new name could else stand for an empty file
        os.fsync(handle)
        temporary.replace(path)
        # the rename is an entry of the folder, which has to reach the disk as well
        _flush(path.parent)
    finally:
        with suppress(OSError):
            temporary.unlink()
        if handle >= 0:
            os.close(handle)
        _open.discard(temporary)


def write_bytes(path: Path, *parts: bytes) -> None:
    """Write a file completely or not at all, part after part; raises InputError as `atomic_write`."""
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.writelines(parts)


def refuse_unwritable(path: Path) -> None:
    """Raise InputError if no file can be written at `path`, or its folder cannot be made; nothing is tried."""
    there = next(
        parent for parent in path.absolute().parents if os.path.exists(parent)
    )  # False where a folder is closed
    if not there.is_dir():
        raise InputError([Fault(f"cannot be written: {there} is a file, not a folder", str(path))])
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError([Fault(f"cannot be written: no right to write into {there}", str(path))])


def sweep(folder: Path, begin: str = ".") -> None:
    """Remove the temporary files in a folder whose writers no longer live, of those whose names begin so."""
    names: list[str] = []
    with suppress(OSError):
        names = os.listdir(folder)  # a folder of 10,000 results is listed for each of them: no Path for each name
    for left in (folder / name for name in names if name.startswith(begin) and name.endswith(".part")):
        if left in _open:
            continue
        with suppress(OSError):
            handle = os.open(left, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))
            try:
                # a writer that lives holds the lock, and this fails
                _lock(handle)
                left.unlink()
            finally:
                os.close(handle)


def discard_all() -> None:
    """Remove all temporary files of this process; for the moment before it ends without unwinding."""
    for temporary in list(_open):
        with suppress(OSError):
            temporary.unlink()


def _lock(handle: int) -> None:
    """Lock an open file until it is closed or its process ends; raise BlockingIOError if another process holds it."""
    try:
        import fcntl
    except ImportError:  # Windows: an open file cannot be removed there, which protects it as well
        return
    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _flush(folder: Path) -> None:
    """Flush the entries of a folder to the disk."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
