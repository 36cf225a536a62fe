"""What commands on results share: results, each reported if it is not fit for use, and the option --require."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from metrocli.cli.console import echo
from metrocli.errors import UsageError
from metrocli.frozen import dataclass

if TYPE_CHECKING:
    from metrocli.record import Record
    from metrocli.result import Result


def opened_result(file: Path) -> tuple[Result, Record]:
    """Return a result and its record; print to stderr why it is not fit for use, if it is not."""
    from metrocli.formats import hdf5

    result, record = hdf5.read(file)
    print_reasons(file, record)
    return result, record


def print_reasons(file: Path, record: Record) -> None:
    """Print to stderr why a result is not fit for use."""
    for reason in record.reasons:
        echo(f"warning: {file} is not fit for use: {reason}", err=True)


NOT_MET = 6
_COMPARISONS = {"<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt}
_FORM = re.compile(r"\s*(\w+)\s*(<=|>=|<|>)\s*([0-9.eE+-]+)\s*")


@dataclass(frozen=True)
class FigureRequirement:
    """A condition such as `max_en < 1`."""

    text: str
    figure: str
    comparison: str
    limit: float

    def exit_code(self, evaluated: object) -> int:
        """Print whether the figure, an attribute of `evaluated`, meets the condition; return 0, or 6 if it does not."""
        value = float(getattr(evaluated, self.figure))
        met = bool(_COMPARISONS[self.comparison](value, self.limit))
        echo(f"required {self.text}: {'met' if met else 'NOT met'} ({value:.4g})", err=True)
        return 0 if met else NOT_MET


def require_option(examples: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option --require; `examples` are conditions for its help."""
    return click.option("--require", metavar="CONDITION", help=f"Exit code 6 unless it is met, {examples}.")


def requirement_of(text: str | None, figures: Sequence[str]) -> FigureRequirement | None:
    """Return the condition, None if none is given; raises UsageError for one that is not on one of the figures."""
    if text is None:
        return None
    parts = _FORM.fullmatch(text)
    try:
        if parts and parts[1] in figures:
            return FigureRequirement(text, parts[1], parts[2], float(parts[3]))
    except ValueError:
        pass
    hint = f"write e.g. 'max_en < 1', with one of {', '.join(figures)}"
    raise UsageError(f"--require '{text}' is not a condition: {hint}")
