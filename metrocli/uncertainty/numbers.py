"""Evaluation of expressions in numbers, for whole arrays of trials at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from metrocli.expressions.expression import NEGATIVE, Expression, Part
from metrocli.frozen import dataclass

Array = npt.NDArray[np.float64]
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, NEGATIVE: np.negative, "sqrt": np.sqrt,
    "exp": np.exp, "log": np.log, "log10": np.log10, "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin,
    "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh,
    "abs": np.abs, "**": np.power,
}  # fmt: skip


@dataclass(frozen=True)
class Numbers:
    """Values by name, each a number or an array of trials; undefined values are NaN or infinite."""

    values: Mapping[str, Any]

    def number(self, value: float) -> Any:
        """Return a plain number."""
        return value

    def name(self, part: Part) -> Any:
        """Return the values of a name."""
        return self.values[part.name]

    def apply(self, part: Part, arguments: Sequence[Any]) -> Any:
        """Return the outcome of one operation."""
        with np.errstate(all="ignore"):
            if part.operation == "**" and isinstance(arguments[1], float) and arguments[1] == 2.0:
                return np.square(arguments[0])
            return _FUNCTIONS[part.operation](*arguments)


def evaluate(expression: Expression, values: Mapping[str, Any]) -> Any:
    """Return the value of an expression, in the shape of the values."""
    return expression.carried_out(Numbers(values))
