"""SIGTERM and SIGINT end any command within a second, and what was begun is taken back."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED, TERMINATED = 130, 143
"""Exit codes that shells give to programs ended by SIGINT and SIGTERM"""
_ENDS = {signal.SIGINT: ("interrupted", INTERRUPTED), signal.SIGTERM: ("terminated", TERMINATED)}
_PATIENCE_S = 0.7
"""Time that a command has to end by itself. Python passes a signal on only between two calls of a library."""


_FIRST: list[bool] = []
"""Holds one element while the next SIGINT does not end the command"""


class Terminated(BaseException):
    """SIGTERM as an exception, so that unfinished files are removed on the way out."""


@contextmanager
def ending() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGINT and Terminated on SIGTERM, and end the process if neither ends the command.

    Does nothing outside the main thread, where no signal arrives.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {signal.SIGTERM: signal.signal(signal.SIGTERM, _terminate)}
    before[signal.SIGINT] = signal.signal(signal.SIGINT, signal.default_int_handler)
    heard, wakes = os.pipe()
    os.set_blocking(wakes, False)
    wake_before = signal.set_wakeup_fd(wakes, warn_on_full_buffer=False)
    done = threading.Event()
    watcher = threading.Thread(target=_watch, args=(heard, done), daemon=True)
    watcher.start()
    try:
        yield
    finally:
        done.set()
        signal.set_wakeup_fd(wake_before)
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(wakes)
        watcher.join()
        os.close(heard)


@contextmanager
def first_interrupt(heeded: Callable[[], None]) -> Iterator[None]:
    """Let the first SIGINT call a function, such as one that ends a search early; a second one ends the command.

    Does nothing outside the main thread, where no signal arrives.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def once(number: int, frame: FrameType | None) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        heeded()

    _FIRST.append(True)
    before = signal.signal(signal.SIGINT, once)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        _FIRST.clear()


def _terminate(number: int, frame: FrameType | None) -> None:
    raise Terminated


def _watch(heard: int, done: threading.Event) -> None:
    """Wait for a signal, then for the end of the command; end the process if that does not come."""
    while number := os.read(heard, 1):
        if number[0] == signal.SIGINT and _FIRST:
            _FIRST.pop()
        elif number[0] in _ENDS and not done.wait(_PATIENCE_S):
            word, code = _ENDS[signal.Signals(number[0])]
            _take_back()
            os.write(2, f"{word}\n".encode())
            os._exit(code)


def _take_back() -> None:
    """Remove what is half written and end the processes that compute for this one."""
    # only what the command has loaded: a module that is being imported at this moment cannot be waited for
    aside = sys.modules.get("metrocli.formats.file_bytes")
    if aside is not None and hasattr(aside, "discard_all"):
        aside.discard_all()
    processes = sys.modules.get("multiprocessing.process")
    if processes is not None:
        for child in processes.active_children():
            child.kill()
