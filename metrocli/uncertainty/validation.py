"""Numbers of uncertainties: coverage, rounding, and the validation of the GUM by Monte Carlo."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from metrocli.expressions.expression import NEGATIVE, Expression, Part
from metrocli.frozen import dataclass
from metrocli.uncertainty.monte_carlo import tolerance_of

Array = npt.NDArray[np.float64]
PROBABILITY = 0.954499736
"""That of two standard deviations of a normal distribution"""
COVERAGE = (2.0, 2.4860, 2.8329)
"""k of one, two and three components of a deviation with infinitely many degrees of freedom (JCGM 102, 6.5.3)"""


def factor(components: npt.NDArray[np.intp] | int, dof: Array | float) -> Array:
    """Return the k of deviations of 0 to 3 components: `k^2 = q F_p(q, dof)`, for q = 1 the t factor (GUM G.6.4).

    With a covariance from `dof` degrees of freedom the square of a deviation, divided by q, has that F distribution.
    """
    q, dof = np.broadcast_arrays(np.asarray(components), np.asarray(dof, dtype=float))
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


_NOTABLE = 0.05
"""Smallest share of a variance or of a width that is reported"""


@dataclass(frozen=True)
class Judged:
    """The results of both methods for one measurand."""

    value: float
    std: float
    U: float
    nonlinear: float
    """Share of the second order in the variance"""
    second_std: float
    """Second-order standard uncertainty; NaN if its variance is negative"""
    mean: float
    mc_std: float
    interval: tuple[float, float]
    """Symmetric coverage interval of Monte Carlo"""
    normal_factor: float
    """Coverage factor of the probability for a normal distribution"""


@dataclass(frozen=True)
class Verdict:
    """Whether Monte Carlo validates GUM, and the reasons if not."""

    valid: bool
    reasons: tuple[str, ...]


def judge(found: Judged, digits: int) -> Verdict:
    """Return the verdict: valid if the interval ends differ by at most half of the last digit of u (JCGM 101, 8.1).

    Otherwise the verdict lists reasons: a non-linear model (share of the second order, shift of the mean), a
    distribution that is not normal (k by Monte Carlo), or quantities with few degrees of freedom.
    """
    allowed = tolerance_of(found.std or found.mc_std, digits)
    low = abs(found.value - found.U - found.interval[0])
    high = abs(found.value + found.U - found.interval[1])
    valid = low <= allowed and high <= allowed
    return Verdict(valid, () if valid else tuple(_reasons(found)))


def _reasons(found: Judged) -> Sequence[str]:
    lines = []
    if found.std == 0:
        return ["the model has no first-order sensitivity at the best estimates; only its higher orders act"]
    if found.nonlinear > _NOTABLE:
        lines.append(f"the model is not linear: the second order makes {100 * found.nonlinear:.0f} % of the variance")
    shift = found.mean - found.value
    if abs(shift) > 2 * _NOTABLE * found.std:
        lines.append(f"the mean is shifted by {shift / found.std:+.2f} u against the value at the best estimates")
    if found.mc_std > found.second_std * (1 + _NOTABLE):
        more = found.mc_std / found.second_std
        lines.append(f"the std of the trials is {more:.2f} times the second-order u: few degrees of freedom")
    if found.mc_std > 0:
        half = (found.interval[1] - found.interval[0]) / 2
        factor = half / found.mc_std
        if abs(factor / found.normal_factor - 1) > _NOTABLE / 2:
            normal = f"a normal one needs {found.normal_factor:.2f}"
            lines.append(f"the distribution is not normal: it needs k = {factor:.2f}, {normal}")
        skew = (found.interval[1] + found.interval[0]) / 2 - found.mean
        if abs(skew) > 2 * _NOTABLE * half:
            lines.append(
                f"the distribution is skew: the middle of its interval lies {skew / found.mc_std:+.2f} u from its mean"
            )
        if not lines and not math.isclose(found.U, half, rel_tol=_NOTABLE / 2):
            lines.append(f"U is {found.U / half:.3f} times the half-width of the coverage interval")
    return lines or ["the intervals differ by slightly more than the significant digits allow"]
