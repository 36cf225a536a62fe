"""A table of the jobs in work, redrawn in place on a terminal while a run goes on, and gone when it ends."""

from __future__ import annotations

import os
import sys
import threading
import time
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext

from metrocli.cli.console import printable
from metrocli.cli.shell.fitted import terminal_size

_FIRST_S = 0.3
"""Time before the table first appears: a run that is over sooner shows none [s]"""
_EVERY_S = 0.25
"""Time between two looks at the clock; only a table that has changed is drawn [s]"""
_RATE_S = 2.0
"""Time from which on the jobs that are done show how long the others will take [s]"""
_UP_TO_DATE, _NOT_RUN = "up to date", "not run"
"""What becomes of jobs that take no time"""
_LEAST = (12, 4)
"""Columns and lines of the smallest terminal on which it is drawn"""
_BEGIN, _END = "\x1b[?2026h", "\x1b[?2026l"
"""Between these a terminal shows no half of a change; terminals that do not know them ignore them"""
_TO_LINE_END, _TO_SCREEN_END = "\x1b[K", "\x1b[J"


class LiveTable:
    """The jobs of a run that are in work, each with its time, below what the run prints."""

    def __init__(self, total: int, write: Callable[[str], object], size: Callable[[], tuple[int, int]]) -> None:
        """`write` sends text to the terminal at once, `size` returns its columns and lines."""
        self._total, self._write, self._size = total, write, size
        self._begun = time.monotonic()
        self._working: dict[str, float] = {}
        self._done: Counter[str] = Counter()
        self._shown: tuple[str, ...] = ()
        self._lock = threading.RLock()

    @property
    def seconds(self) -> float:
        """Time since the run began [s]."""
        return time.monotonic() - self._begun

    def begin(self, name: str) -> None:
        """Add a job that is in work from now on."""
        with self._lock:
            self._working[name] = time.monotonic()

    @contextmanager
    def end(self, name: str, action: str) -> Iterator[None]:
        """Count a job as done; what is printed within the context stands above the table."""
        with self._lock:
            self._working.pop(name, None)
            self._done[action] += 1
            below = len(self._shown)
            if below:
                self._write(_BEGIN + _back(below) + _TO_SCREEN_END)
            self._shown = ()
            try:
                yield
            finally:
                if below:
                    self.draw()
                    self._write(_END)

    def draw(self) -> None:
        """Draw the table over itself, if it has changed."""
        with self._lock:
            columns, lines = self._size()
            now = time.monotonic()
            fits = columns >= _LEAST[0] and lines >= _LEAST[1]
            table = tuple(cropped(line, columns - 1) for line in self._lines(now, lines - 2)) if fits else ()
            if table == self._shown:
                return
            text = "".join(f"{line}{_TO_LINE_END}\n" for line in table)
            self._write(f"{_BEGIN}{_back(len(self._shown))}{text}{_TO_SCREEN_END}{_END}")
            self._shown = table

    def clear(self) -> None:
        """Remove the table from the terminal."""
        with self._lock:
            if self._shown:
                self._write(_back(len(self._shown)) + _TO_SCREEN_END)
            self._shown = ()

    def _lines(self, now: float, most: int) -> Iterator[str]:
        """Yield at most so many lines (2 or more): the counts, then the jobs that are in work longest."""
        done = self._done.total()
        bad = "".join(f", {count} {what}" for what, count in self._done.items() if what in ("failed", _NOT_RUN))
        waiting = self._total - done - len(self._working)
        counts = f"{done} of {self._total} done{bad}, {len(self._working)} running, {waiting} waiting"
        passed = now - self._begun
        yield f"{counts}, {time_text(passed)}{self._left(passed)}"
        names = list(self._working)
        room = most - 1 if len(names) < most else most - 2
        for name in names[:room]:
            yield f"{time_text(now - self._working[name]):>9}  {printable(name)}"
        if room < len(names):
            yield f"{'':>9}  and {len(names) - room} more"

    def _left(self, passed: float) -> str:
        """Return how long the others take if they take as long as those that ran: at most so long if some did not."""
        done = self._done.total()
        ran = done - self._done[_UP_TO_DATE] - self._done[_NOT_RUN]
        if not ran or done == self._total or passed < _RATE_S:
            return ""
        return f", {'about' if ran == done else 'at most'} {time_text(passed * (self._total - done) / ran)} left"


@contextmanager
def live_table(total: int, shown: bool) -> Iterator[LiveTable]:
    """Yield a table of so many jobs, redrawn on the terminal of stderr as time goes on, and cleared at the end.

    A table that is not `shown` is never drawn.
    """
    table = LiveTable(total, to_terminal, lambda: terminal_size(sys.stderr.fileno()))
    try:
        with redrawn(table.draw, _FIRST_S, _EVERY_S) if shown else nullcontext():
            yield table
    finally:
        table.clear()


def to_terminal(text: str) -> None:
    """Write to the terminal of stderr at once, after what was printed."""
    sys.stdout.flush()
    sys.stderr.write(text)
    sys.stderr.flush()


@contextmanager
def redrawn(draw: Callable[[], None], first: float, every: float) -> Iterator[None]:
    """Draw in a thread after the `first` seconds, and then `every` so many, until the context ends."""
    over = threading.Event()

    def go_on() -> None:
        pause = first
        while not over.wait(pause):
            draw()
            pause = every

    thread = threading.Thread(target=go_on, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def has_terminal() -> bool:
    """Return whether stderr is a terminal on which a table can be redrawn."""
    return sys.stderr.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def time_text(seconds: float) -> str:
    """Return a time in whole seconds, such as 7 s, 3 min 07 s or 2 h 05 min."""
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def _back(lines: int) -> str:
    """Return what moves the cursor to the begin of the line so many lines above."""
    return f"\r\x1b[{lines}A" if lines else ""


def cropped(line: str, columns: int) -> str:
    """Return a line that takes at most so many columns, since a longer one would take two lines of the terminal."""
    if line.isascii() and len(line) <= columns:
        return line
    return line[: _fitting([_columns(letter) for letter in line], columns)]


def _fitting(widths: Sequence[int], columns: int) -> int:
    """Return how many letters fit."""
    taken = 0
    for number, width in enumerate(widths):
        taken += width
        if taken > columns:
            return number
    return len(widths)


def _columns(letter: str) -> int:
    if unicodedata.combining(letter):
        return 0
    return 2 if unicodedata.east_asian_width(letter) in "WF" else 1
