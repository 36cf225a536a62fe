"""Words that a shell offers for arguments whose values the command line itself does not list."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metrocli.errors import InputError
from metrocli.tasks import KINDS

if TYPE_CHECKING:
    import click

Complete = Callable[["click.Context", "click.Parameter", str], list[Any]]


def offering(words: Callable[[], Iterable[str]]) -> Complete:
    """Return the function by which an argument or option is completed; `words` is called only then."""
    return lambda context, parameter, begun: [word for word in words() if word.startswith(begun)]


def kinds() -> Iterable[str]:
    """Return the kinds of job."""
    return KINDS


def figures() -> Iterable[str]:
    """Return the names of all figures."""
    from metrocli.plots import FIGURES

    return FIGURES


def tables(context: click.Context, parameter: click.Parameter, begun: str) -> list[str]:
    """Return the names of the tables of the result that the line names; none if it names none that can be read."""
    from metrocli.formats import hdf5

    # click leaves the arguments of a line whose last option has no value yet where it keeps those that nobody wants
    given = [Path(path) for path in (context.params.get("result"), *context.args) if path is not None]
    try:
        result, _ = hdf5.read(given[0])
    except (InputError, IndexError):
        return []
    return [name for name in result.tables if name.startswith(begun)]
