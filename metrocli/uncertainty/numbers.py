"""Numbers of uncertainties: expressions of quantities at draws, coverage factors and effective degrees of freedom."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.expressions.expression import NEGATIVE, Expression, Operation
from metrocli.frozen import dataclass

PROBABILITY = 0.954499736
"""That of two standard deviations of a normal distribution"""
COVERAGE = (2.0, 2.4860, 2.8329)
"""k of one, two and three components of a deviation with infinitely many degrees of freedom (JCGM 102, 6.5.3)"""


def factor(components: Index | int, dof: Array | float) -> Array:
    """Return the k of deviations of 0 to 3 components: `k^2 = q F_p(q, dof)`, for q = 1 the t factor (GUM G.6.4).

    With a covariance from `dof` degrees of freedom the square of a deviation, divided by q, has that F distribution.
    """
    q, dof = np.broadcast_arrays(np.asarray(components), np.asarray(dof, dtype=float))
    # k of 0 components is that of one: a deviation of rank 0 needs some number, and nothing is divided by it
    k = np.array(np.array([COVERAGE[0], *COVERAGE])[q])
    few = np.isfinite(dof) & (q > 0)
    if few.any():
        from scipy.special import fdtri

        k[few] = np.sqrt(q[few] * fdtri(q[few], dof[few], PROBABILITY))
    return np.asarray(k)


def effective(dof: float, part: Array, whole: Array) -> Array:
    """Return the degrees of freedom of variances `whole`, of which `part` has `dof` and the rest infinitely many.

    Welch-Satterthwaite: `dof (whole / part)^2` (GUM G.4.1).
    """
    if math.isinf(dof):
        return np.full(np.shape(whole), math.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(part > 0, dof * (whole / part) ** 2, math.inf))


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

    def name(self, part: Operation) -> Any:
        """Return the values of a name."""
        return self.values[part.name]

    def apply(self, part: Operation, arguments: Sequence[Any]) -> Any:
        """Return the outcome of one operation."""
        with np.errstate(all="ignore"):
            # several times faster than a power, and the most frequent one
            if part.operation == "**" and isinstance(arguments[1], float) and arguments[1] == 2.0:
                return np.square(arguments[0])
            return _FUNCTIONS[part.operation](*arguments)


def evaluate(expression: Expression, values: Mapping[str, Any]) -> Any:
    """Return the value of an expression, in the shape of the values."""
    return expression.carried_out(Numbers(values))
