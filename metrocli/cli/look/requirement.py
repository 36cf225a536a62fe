"""The option --require: one condition on a figure of the command, and the exit code where it is not met."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Sequence
from typing import Any

import click

from metrocli.cli.console import echo
from metrocli.errors import UsageError
from metrocli.frozen import dataclass

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
        """Print to stderr whether the figure, an attribute of `found`, meets the condition; return 0, or 6 if not."""
        value = float(getattr(evaluated, self.figure))
        met = bool(_COMPARISONS[self.comparison](value, self.limit))
        echo(f"required {self.text}: {'met' if met else 'NOT met'} ({value:.4g})", err=True)
        return 0 if met else NOT_MET


def option(examples: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option; `examples` are conditions for its help."""
    return click.option("--require", metavar="CONDITION", help=f"Exit code 6 unless it is met, {examples}.")


def read(text: str | None, figures: Sequence[str]) -> FigureRequirement | None:
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
