"""Files of a run: its lock, the dependencies for make, and the chunks of a job."""

from __future__ import annotations

import contextlib
import os
import re
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from metrocli.errors import Fault, InputError
from metrocli.formats.own_files import write_all
from metrocli.frozen import dataclass
from metrocli.project.steps import ProjectStep
from metrocli.uncertainty.workers import Finished

_PAUSE_S = 0.1


@contextmanager
def locked(project_file: Path, wait: bool) -> Iterator[None]:
    """Hold the project for one run, by a lock of the operating system on its metrocli.yaml.

    If another run holds it, wait for it or raise InputError. Where the system has no such locks (Windows, some network
    folders), nothing is locked; results are still written whole.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    handle = os.open(project_file, os.O_RDONLY)
    try:
        while True:
            try:
                # the system lets go of it when the process ends, however it does: a kill leaves nothing to unlock
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError as error:
                if not wait:
                    fault = Fault("another run works on this project", str(project_file), hint="--wait waits for it")
                    raise InputError([fault]) from error
                time.sleep(_PAUSE_S)
            except OSError:
                break
        yield
    finally:
        # closing it unlocks it
        os.close(handle)


def renew(project_file: Path, steps: Iterable[ProjectStep]) -> None:
    """Give results that are older than what they depend on the present time, without which Make would run for ever.

    These are results that are up to date or came out as before, which else keep their time.
    """
    for step in steps:
        needed = step.job.file, project_file, *step.job.stated_in, *step.job.files
        youngest = max(path.stat().st_mtime_ns for path in needed if path.exists())
        if step.job.output.exists() and step.job.output.stat().st_mtime_ns < youngest:
            os.utime(step.job.output)


_SPECIAL = re.compile(r"(\\*)([ #:*?\[])")
"""What Make takes as itself behind a backslash, and the backslashes before it, which then count twice"""
_FOREIGN = re.compile(r"[%=;|\x00-\x1f\x7f]|\\$")
"""What Make takes as itself nowhere"""


def write(path: Path, project_file: Path, steps: Sequence[ProjectStep], force: bool = False) -> None:
    """Write a rule without commands for each result: it depends on its job, its inputs and the project file.

    A folder in which a pattern of images is matched counts as an input. What decides which files these are is in a rule
    for the file itself, and each of them in a rule of its own, so that Make goes on if it is gone. Paths are relative
    to the working folder, as Make needs them, if they lie below it. Raises InputError with each name that Make cannot
    read, and if a file is there that metrocli did not write, unless forced.
    """
    faults: list[Fault] = []
    rules: dict[str, dict[str, None]] = {}
    deciding: dict[str, None] = {}
    for step in steps:
        searched = (folder for item in step.job.inputs for folder in item.searched)
        stated = dict.fromkeys(_word(path, faults) for path in (step.job.file, project_file, *step.job.stated_in))
        folders = dict.fromkeys(_word(folder, faults) for folder in searched)
        needed = stated | dict.fromkeys(_word(file, faults) for file in step.job.files) | folders
        rules[_word(step.job.output, faults)] = needed
        deciding |= stated | folders
    rules |= {_word(path, faults): deciding} | {name: {} for name in deciding}
    if faults:
        raise InputError(list(dict.fromkeys(faults)))
    text = "".join(f"{' '.join((f'{name}:', *needed))}\n" for name, needed in rules.items())
    list(write_all({path: text.encode()}, force))
    # a folder of images that holds this file has its time, and must not be younger
    os.utime(path)


def _word(path: Path, faults: list[Fault]) -> str:
    text = os.path.normpath(path)
    if _FOREIGN.search(text):
        faults.append(Fault("Make cannot read this name", text, hint="rename it without %=;|"))
    return _SPECIAL.sub(r"\1\1\\\2", text).replace("$", "$$")


@dataclass(frozen=True)
class ChunkFolder(Finished):
    """A folder with one .npz file for each finished chunk: KEY OF THE COMPUTATION-NUMBER.npz."""

    folder: Path

    def get(self, key: str, number: int) -> dict[str, Any] | None:
        """Return the arrays of a chunk, or None if its file is missing or damaged."""
        path = self._path(key, number)
        if not path.is_file():
            return None
        from zipfile import BadZipFile

        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as held:
                return dict(held)
        except (OSError, ValueError, BadZipFile):
            return None

    def put(self, key: str, number: int, value: dict[str, Any]) -> None:
        """Write the arrays of a chunk, whole or not at all; disk errors are ignored: the job runs without."""
        with contextlib.suppress(OSError):
            self.folder.mkdir(parents=True, exist_ok=True)
            aside = self._path(key, number).with_suffix(f".{os.getpid()}.tmp")
            with aside.open("wb") as file:
                np.savez(file, **value)
            aside.replace(self._path(key, number))

    def clear(self) -> None:
        """Remove all chunks and the folder."""
        if self.folder.is_dir():
            for path in [*self.folder.glob("*.npz"), *self.folder.glob("*.tmp")]:
                path.unlink(missing_ok=True)
            with contextlib.suppress(OSError):
                self.folder.rmdir()

    def _path(self, key: str, number: int) -> Path:
        return self.folder / f"{key}-{number:06d}.npz"
