"""Words that a shell offers for arguments whose values the command line itself does not list."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import click

Complete = Callable[["click.Context", "click.Parameter", str], list[Any]]


def offering(words: Callable[[], Iterable[str]]) -> Complete:
    """Return the function by which an argument or option is completed; `words` is called only then."""
    return lambda context, parameter, begun: [word for word in words() if word.startswith(begun)]


def kinds() -> Iterable[str]:
    """Return the kinds of job."""
    from metrocli.tasks import KINDS

    return KINDS


def figures() -> Iterable[str]:
    """Return the names of all figures."""
    from metrocli.plots import FIGURES

    return FIGURES
