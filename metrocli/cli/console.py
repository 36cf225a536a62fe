"""What a command prints: results to stdout; progress and warnings to stderr."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import click

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
"""Characters by which a text could take over a terminal, or show its letters in another order

All control characters but the tab and the end of a line, and those that turn the direction of writing.
"""
_FIRST_S, _EVERY_S = 2.0, 0.5
"""Time before a line of progress appears, and between two of them [s]"""


def echo(text: str, err: bool = False, nl: bool = True, as_is: bool = False) -> None:
    """Print a text to stdout or stderr; control characters, which files of others may contain, are replaced.

    On a terminal its lines fit the width, unless it is JSON or is to be printed `as_is`, and its deciding words have
    colours, unless NO_COLOR is set.
    """
    text = printable(text)
    stream = sys.stderr if err else sys.stdout
    if stream is not None and not stream.closed and stream.isatty() and not as_is and not text.startswith(("{", "[")):
        from metrocli.cli.shell.fitted import coloured, fitted, terminal_size

        text = fitted(text, terminal_size(stream.fileno())[0])
        if not os.environ.get("NO_COLOR") and os.environ.get("TERM", "dumb") != "dumb":
            text = coloured(text)
    click.echo(text, err=err, nl=nl)


def printable(text: str) -> str:
    """Return a text without control characters."""
    return _CONTROL.sub("\N{REPLACEMENT CHARACTER}", text)


def progress_text(done: int, of: int | None, elapsed: float) -> str:
    """Return how many parts are done and, where their number is known, how long the others take at that rate [s].

    Without parts, or after the last, return the time since the begin.
    """
    if not of:
        return f"{done} parts" if done else f"{elapsed:.0f} s"
    if not done:
        return f"0 of {of} parts"
    if done >= of:
        return f"{done} of {of} parts, {elapsed:.0f} s"
    return f"{done} of {of} parts, about {elapsed * (of - done) / done:.0f} s left"


@dataclass(frozen=True)
class Console:
    """Print as much as `--quiet` and `--verbose` ask for."""

    quiet: bool = False
    verbose: bool = False

    def print(self, line: str) -> None:
        """Print a line to stdout, unless quiet."""
        if not self.quiet:
            echo(line)

    def warning(self, line: str) -> None:
        """Print a warning to stderr, unless quiet."""
        if not self.quiet:
            echo(f"warning: {line}", err=True)

    def detail(self, line: str) -> None:
        """Print to stderr what is being done, with --verbose only."""
        if self.verbose:
            echo(line, err=True)

    def waiting(self, line: str) -> None:
        """Print to stderr what takes time, where a person watches the terminal or with --verbose."""
        if self.verbose or (not self.quiet and sys.stderr.isatty()):
            echo(line, err=True)

    @contextmanager
    def part_counter(self) -> Iterator[Callable[[int, int | None], None]]:
        """Yield a function that takes how many parts of a long computation are done.

        A line on the terminal shows them, or the time while there are none, from the third second to the end.
        """
        import threading
        import time

        begun, length = time.monotonic(), 0
        told: tuple[int, int | None] = (0, None)
        over = threading.Event()

        def tell(done: int, of: int | None) -> None:
            nonlocal told
            told = (done, of)

        def draw() -> None:
            nonlocal length
            pause = _FIRST_S
            while not over.wait(pause):
                text = progress_text(*told, time.monotonic() - begun)
                click.echo(f"\r{text:{length}}", err=True, nl=False)
                length, pause = len(text), _EVERY_S

        if self.quiet or not sys.stderr.isatty():
            yield tell
            return
        thread = threading.Thread(target=draw, daemon=True)
        thread.start()
        try:
            yield tell
        finally:
            over.set()
            thread.join()
            click.echo(f"\r{'':{length}}\r" if length else "", err=True, nl=False)


def print_files(paths: Iterable[Path], as_json: bool, quiet: bool, **more: str) -> int:
    """Print the paths of files that were written, or with more keys as JSON; return the exit code 0."""
    written = [str(path) for path in paths]  # all are written before the reader of this output closes it at any line
    if as_json:
        from metrocli.cli.summary import as_json as json_text

        echo(json_text({**more, "files": written}))
    else:
        console = Console(quiet)
        for path in written:
            console.print(path)
    return 0
