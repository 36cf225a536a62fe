"""Files that metrocli wrote into folders of its users: replaced only while they are as it wrote them."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from hashlib import sha256
from pathlib import Path

from metrocli.errors import Fault, InputError
from metrocli.formats.aside import folder_made, refuse_unwritable, write_bytes

LIST = ".metrocli-files"
"""In each folder: a line `SHA-256  NAME` for each file that metrocli wrote there, as `sha256sum --check` reads it"""


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file in a folder; raise InputError if the name leads out of it."""
    parts = Path(name).parts
    if not parts or Path(name).is_absolute() or ".." in parts or "\0" in name:
        raise InputError([Fault(f"'{name}' is not the name of a file inside {folder}", hint="rename it in the inputs")])
    return folder / name


def write_all(contents: Mapping[Path, bytes], force: bool = False) -> Iterator[Path]:
    """Write files and yield each path once it is written.

    Raises InputError, before anything is written, if one of them exists that metrocli did not write, or that was
    changed since then, unless forced.
    """
    with _alone_in(path.parent for path in contents):
        yield from _write_all(contents, force)


def _write_all(contents: Mapping[Path, bytes], force: bool) -> Iterator[Path]:
    for path in contents:
        refuse_unwritable(path)
    lists = {path.parent: _listed(path.parent) for path in contents}
    faults = []
    for path, data in contents.items():
        if not force and path.exists() and not _may_replace(path, data, lists[path.parent]):
            hint = "choose another name or folder, or use --force"
            faults.append(Fault("the file exists, and metrocli did not write it so", str(path), hint=hint))
    if faults:
        raise InputError(faults)
    # listed before they are written, beside what is there: after a kill the next call knows them by either digest
    before = {path: lists[path.parent].get(path.name, set()) for path in contents}
    for path, data in contents.items():
        lists[path.parent][path.name] = before[path] | {_digest(data)}
    _write_lists(lists)
    for path, data in contents.items():
        write_bytes(path, data)
        lists[path.parent][path.name] = {_digest(data)}
        yield path
    if any(before.values()):
        _write_lists(lists)


def _write_lists(lists: Mapping[Path, Mapping[str, Collection[str]]]) -> None:
    for folder, names in lists.items():
        lines = (f"{digest}  {name}\n" for name, digests in sorted(names.items()) for digest in sorted(digests))
        write_bytes(folder / LIST, "".join(lines).encode())


@contextmanager
def _alone_in(folders: Iterable[Path]) -> Iterator[None]:
    """Hold folders, which are made if need be: others that write there at the same time wait, so no entry is lost.

    Where the system has no such locks, nothing is held. Raises InputError if a folder cannot be made.
    """
    with ExitStack() as held:
        try:
            import fcntl

            for folder in sorted(set(folders)):
                held.enter_context(folder_made(folder))
                handle = os.open(folder, os.O_RDONLY)
                held.callback(os.close, handle)
                fcntl.flock(handle, fcntl.LOCK_EX)
        except ImportError:
            pass
        except OSError as error:
            raise InputError([Fault(f"cannot be written: {error.strerror}", str(error.filename))]) from error
        yield


def _may_replace(path: Path, data: bytes, listed: Mapping[str, Collection[str]]) -> bool:
    if not path.is_file():
        return False
    there = path.read_bytes()
    return there == data or _digest(there) in listed.get(path.name, ())


def _listed(folder: Path) -> dict[str, set[str]]:
    """Return the digests of the files of a folder by their names, several where a call was killed."""
    found: dict[str, set[str]] = {}
    try:
        lines = (folder / LIST).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return {}
    for digest, _, name in (line.partition("  ") for line in lines):
        found.setdefault(name, set()).add(digest)
    return found


def _digest(data: bytes) -> str:
    return sha256(data).hexdigest()
