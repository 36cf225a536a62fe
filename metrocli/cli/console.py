"""What a command prints: results to stdout; progress and warnings to stderr."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import click

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f]")
"""Characters by which a text could take over a terminal: all control characters but the tab and the end of a line"""


def echo(text: str, err: bool = False, nl: bool = True, as_is: bool = False) -> None:
    """Print a text to stdout or stderr; control characters, which files of others may contain, are replaced.

    On a terminal its lines fit the width, unless it is JSON or is to be printed `as_is`, and its deciding words have
    colours, unless NO_COLOR is set.
    """
    text = printable(text)
    stream = sys.stderr if err else sys.stdout
    if stream is not None and not stream.closed and stream.isatty() and not as_is and not text.startswith(("{", "[")):
        from metrocli.cli.shell.fitted import coloured, fitted
        from metrocli.cli.shell.live_table import terminal_size

        text = fitted(text, terminal_size(stream.fileno())[0])
        if not os.environ.get("NO_COLOR") and os.environ.get("TERM", "dumb") != "dumb":
            text = coloured(text)
    click.echo(text, err=err, nl=nl)


def printable(text: str) -> str:
    """Return a text without control characters."""
    return _CONTROL.sub("\N{REPLACEMENT CHARACTER}", text)


def progress_text(done: int, of: int | None, elapsed: float) -> str:
    """Return how many parts are done and, where their number is known, how long the others take at that rate [s]."""
    if not of:
        return f"{done} parts"
    if not done:
        return f"0 of {of} parts"
    left = elapsed * (of - done) / done
    # spaces at the end clear what a longer line left
    return f"{done} of {of} parts, about {left:.0f} s left   "


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
        """Yield a function that shows on a terminal how many parts of a long computation are done.

        Nothing is shown in the first two seconds.
        """
        import time

        begun, shown = time.monotonic(), False
        watched = not self.quiet and sys.stderr.isatty()

        def show(done: int, of: int | None) -> None:
            nonlocal shown
            if watched and time.monotonic() - begun > 2:
                click.echo(f"\r{progress_text(done, of, time.monotonic() - begun)}", err=True, nl=False)
                shown = True

        try:
            yield show
        finally:
            if shown:
                click.echo(err=True)
