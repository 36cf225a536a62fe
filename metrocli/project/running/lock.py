"""One run at a time on a project: a lock that dies with the process that holds it, and leaves no file."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from metrocli.errors import Fault, InputError

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
        os.close(handle)
