"""Options that several commands have."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from metrocli.tasks.kind import Question

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
JOB = click.argument("job", type=click.Path(path_type=Path), metavar="JOB.yaml")
JSON = click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON and nothing else on stdout.")
FORCE = click.option("--force", is_flag=True, help="Replace an output that is something else.")
SET = click.option("--set", "overrides", multiple=True, metavar="KEY.PATH=VALUE", help="Change one value of the job.")
OUTPUT = click.option("--output", type=click.Path(path_type=Path), metavar="FILE.h5", help="Write the result here.")
DRY_RUN = click.option("--dry-run", is_flag=True, help="Check everything, compute and write nothing.")
QUIET = click.option("--quiet", "-q", is_flag=True, help="Tell nothing but failures.")
VERBOSE = click.option("--verbose", "-v", is_flag=True, help="Tell what is being done, on stderr.")

WORKERS = click.option(
    "--workers", type=click.IntRange(0), metavar="N", default=0, help="Threads; all cores unless given."
)
SCHEDULER = click.option(
    "--scheduler", default="", metavar="ADDRESS", help="Dask scheduler to do the work: tcp://HOST:PORT or its file."
)


def asking(question: Question) -> Decorator:
    """Return the option of a question: a flag, or as many values as it has arguments."""
    if not question.arguments:
        return click.option(f"--{question.name}", is_flag=True, help=question.help)
    metavar = " ".join(question.arguments)
    return click.option(f"--{question.name}", nargs=len(question.arguments), metavar=metavar, help=question.help)


def all_of(*options: Decorator) -> Decorator:
    """Return several options as one decorator, shown in their order."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


@dataclass(frozen=True)
class Voice:
    """How much is told, and where."""

    quiet: bool = False
    verbose: bool = False

    def progress(self, line: str) -> None:
        """Tell on stderr what is being done, where that was asked for."""
        if self.verbose:
            click.echo(line, err=True)

    def waiting(self, line: str) -> None:
        """Tell on stderr what takes its time, where a person is watching."""
        if self.verbose or (not self.quiet and sys.stderr.isatty()):
            click.echo(line, err=True)

    @contextmanager
    def counting(self) -> Iterator[Callable[[int, int | None], None]]:
        """Give what tells on a terminal how many parts of a long computation are done, after two seconds."""
        import sys
        import time

        begun, told = time.monotonic(), False
        shown = not self.quiet and sys.stderr.isatty()

        def tell(done: int, of: int | None) -> None:
            nonlocal told
            if shown and time.monotonic() - begun > 2:
                click.echo(f"\r{done} of {of} parts" if of else f"\r{done} parts", err=True, nl=False)
                told = True

        try:
            yield tell
        finally:
            if told:
                click.echo(err=True)

    def warning(self, line: str) -> None:
        """Tell on stderr what the user should know."""
        if not self.quiet:
            click.echo(f"warning: {line}", err=True)

    def line(self, line: str) -> None:
        """Tell on stdout."""
        if not self.quiet:
            click.echo(line)
