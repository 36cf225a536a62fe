"""One line on the terminal that shows what a command is doing, for how long, and how long that still takes."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any

from metrocli.cli.console import LINES, printable
from metrocli.cli.shell.fitted import terminal_size
from metrocli.cli.shell.live_table import cropped, redrawn, time_text, to_terminal

_FIRST_S, _EVERY_S = 2.0, 0.5
"""Time before the line appears, and between two drawings of it [s]"""
_LEAST_S = 1.0
"""A rest of time below this is not shown [s]"""


class ProgressLine:
    """How long a command has taken, and what it is doing. How long it still takes is shown only where that is known.

    That is so for counted parts, of which the others take as long as those that are done, and for a search that ends
    after a limit of CPU time.
    """

    def __init__(
        self,
        write: Callable[[str], object],
        columns: Callable[[], int],
        clock: Callable[[], float] = time.monotonic,
        cpu: Callable[[], float] = time.process_time,
    ) -> None:
        """`write` sends text to the terminal at once, `columns` returns its width."""
        self._write, self._columns, self._clock, self._cpu = write, columns, clock, cpu
        self._lock = threading.RLock()
        self._shown = 0
        self._begun = clock()
        self.doing("")

    def doing(self, line: str, most: float = math.inf) -> None:
        """Show what is done from now on; the search in it ends after `most` CPU time at the latest [s]."""
        with self._lock:
            self._line = line
            self._done: int = 0
            self._of: int | None = None
            self._counted = self._clock()
            self._end = self._cpu() + most

    def count(self, done: int, of: int | None) -> None:
        """Show how many parts are done, of how many if that is known."""
        with self._lock:
            self._done, self._of = done, of
            if not done:
                self._counted = self._clock()

    def text(self) -> str:
        """Return the line: its time first, then what is done, cropped so that the terminal has room for the rest."""
        with self._lock:
            columns, now = self._columns() - 1, self._clock()
            begin, end = f"{time_text(now - self._begun)}  ", ", ".join(filter(None, [self._parts(), self._rest(now)]))
            end = f", {end}" if self._line and end else end
            line = cropped(printable(self._line), max(columns - len(begin) - len(end), 0))
            return cropped(f"{begin}{line}{end}", columns).rstrip()

    def _parts(self) -> str:
        if self._of is None:
            return f"{self._done} parts" if self._done else ""
        return f"{self._done} of {self._of} parts" if self._done < self._of else ""

    def _rest(self, now: float) -> str:
        """Return how long the other parts take at the rate of those that are done, else the limit of the search."""
        if self._of is not None and 0 < self._done < self._of:
            return f"about {time_text((now - self._counted) * (self._of - self._done) / self._done)} left"
        left = self._end - self._cpu()
        return f"at most {time_text(left)} of search left" if _LEAST_S <= left < math.inf else ""

    def draw(self) -> None:
        """Draw the line over itself."""
        with self._lock:
            text = self.text()
            self._write(f"\r{text:{self._shown}}")
            self._shown = len(text)

    @contextmanager
    def away(self) -> Iterator[None]:
        """Remove the line; what is printed within the context stands in its place."""
        with self._lock:
            if self._shown:
                self._write(f"\r{'':{self._shown}}\r")
            self._shown = 0
            yield


def with_progress(command: Callable[..., int]) -> Callable[..., int]:
    """Return a command that draws a progress line on the terminal of stderr from its third second on, unless quiet."""

    @wraps(command)
    def carried_out(*arguments: Any, **options: Any) -> int:
        if options.get("quiet") or not sys.stderr.isatty():
            return command(*arguments, **options)
        with _drawn_line():
            return command(*arguments, **options)

    return carried_out


@contextmanager
def _drawn_line() -> Iterator[None]:
    line = ProgressLine(to_terminal, lambda: terminal_size(sys.stderr.fileno())[0])
    LINES.append(line)
    try:
        with redrawn(line.draw, _FIRST_S, _EVERY_S):
            yield
    finally:
        LINES.remove(line)
        with line.away():
            pass
