"""What a command prints: results to stdout; progress and warnings to stderr."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from typing import Any, Protocol

import click

from metrocli.cli.shell.fitted import coloured, fitted, terminal_size
from metrocli.frozen import dataclass
from metrocli.progress import Progress

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
"""Characters by which a text could take over a terminal, or show its letters in another order

All control characters but the tab and the end of a line, and those that turn the direction of writing.
"""


class DrawnLine(Progress, Protocol):
    """A line that is drawn on the terminal while a command goes on."""

    def away(self) -> AbstractContextManager[None]:
        """Remove the line; what is printed within the context stands in its place."""


LINES: list[DrawnLine] = []
"""The line on the terminal, if there is one"""


def echo(text: str, err: bool = False, nl: bool = True, as_is: bool = False) -> None:
    """Print a text to stdout or stderr; control characters, which files of others may contain, are replaced.

    On a terminal its lines fit the width, unless it is JSON or is to be printed `as_is`, and its deciding words have
    colours, unless NO_COLOR is set.
    """
    text = printable(text)
    stream = sys.stderr if err else sys.stdout
    if stream is not None and not stream.closed and stream.isatty() and not as_is and not text.startswith(("{", "[")):
        text = fitted(text, terminal_size(stream.fileno())[0])
        if not os.environ.get("NO_COLOR") and os.environ.get("TERM", "dumb") != "dumb":
            text = coloured(text)
    with LINES[-1].away() if LINES else nullcontext(), suppress(OSError) if err else nullcontext():
        click.echo(text, err=err, nl=nl)  # a full or closed stderr is not a reason to lose the result


def echo_json(value: Any) -> None:
    """Print a value as JSON text; NaN and infinities are null."""
    from metrocli.cli.summary import as_json

    echo(as_json(value))


def printable(text: str) -> str:
    """Return a text without control characters."""
    return _CONTROL.sub("\N{REPLACEMENT CHARACTER}", text)


@dataclass(frozen=True)
class Console:
    """Print as much as `--quiet` and `--verbose` ask for."""

    quiet: bool = False
    verbose: bool = False

    @property
    def is_watched(self) -> bool:
        """Whether somebody sees on a terminal what goes on."""
        return bool(LINES)

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

    def doing(self, line: str, most: float = math.inf) -> None:
        """Show on the progress line what is done from now on, with --verbose also print it.

        The search in it ends after `most` CPU time at the latest [s].
        """
        for shown in LINES:
            shown.doing(line, most)
        self.detail(line)

    def count(self, done: int, of: int | None) -> None:
        """Show on the progress line how many parts are done, of how many if that is known."""
        for shown in LINES:
            shown.count(done, of)


def print_files(paths: Iterable[Path], as_json: bool, quiet: bool, **more: str) -> int:
    """Print the paths of files that were written, or with more keys as JSON; return the exit code 0."""
    written = [str(path) for path in paths]  # all are written before the reader of this output closes it at any line
    if as_json:
        echo_json({**more, "files": written})
    else:
        console = Console(quiet)
        for path in written:
            console.print(path)
    return 0
