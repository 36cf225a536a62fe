"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from metrocli.errors import UsageError
from metrocli.tasks.kind import Question

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]


def job(required: bool = True) -> Decorator:
    """Return the argument of a job file."""
    metavar = "JOB.yaml" if required else "[JOB.yaml]"
    return click.argument("job", type=click.Path(path_type=Path), metavar=metavar, required=required)


JOB = job()
JSON = click.option("--json", "as_json", is_flag=True, help="Print the summary as JSON and nothing else on stdout.")
FORCE = click.option("--force", is_flag=True, help="Overwrite whatever is at the output.")
SET = click.option(
    "--set", "overrides", multiple=True, metavar="KEY.PATH=VALUE", help="Change one value of the job (repeatable)."
)
OUTPUT = click.option(
    "--output", type=click.Path(path_type=Path), metavar="FILE.h5", help="Write the result to this file."
)
DRY_RUN = click.option("--dry-run", is_flag=True, help="Check everything, compute and write nothing.")
QUIET = click.option("--quiet", "-q", is_flag=True, help="Print failures only.")
ACCEPT = click.option(
    "--accept-doubtful", is_flag=True, help="Use results that are doubtful or do not meet their requirements."
)
STRICT = click.option("--strict", is_flag=True, help="Every warning makes the result doubtful (exit code 6).")
VERBOSE = click.option("--verbose", "-v", is_flag=True, help="Print to stderr what is being done.")

UNITS = click.option("--units", type=click.Choice(["mm", "inch"]), default="mm", help="Unit of lengths; default mm.")
WORKERS = click.option(
    "--workers", type=click.IntRange(0), metavar="N", default=0, help="Number of threads (default: all cores)."
)
SCHEDULER = click.option(
    "--scheduler",
    default="",
    metavar="ADDRESS",
    help="Compute on a Dask cluster: tcp://HOST:PORT or the path of its scheduler file.",
)


def result_file(path: Path | None) -> Path | None:
    """Return the value of --output; raises UsageError if it is not the name of a result file."""
    if path is not None and path.suffix != ".h5":
        raise UsageError(f"--output {path}: the name of a result file ends in .h5")
    return path


def asking(question: Question) -> Decorator:
    """Return the option of a question: a flag, or an option with as many values as the question has arguments."""
    if not question.arguments:
        return click.option(f"--{question.name}", is_flag=True, help=question.help)
    metavar = " ".join(question.arguments)
    return click.option(f"--{question.name}", nargs=len(question.arguments), metavar=metavar, help=question.help)


def all_of(*options: Decorator) -> Decorator:
    """Return several options as one decorator; the help lists them in this order."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


WRITES = all_of(FORCE, JSON, QUIET)
"""Of a command that writes files and prints their paths"""
