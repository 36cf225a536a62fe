"""Exact first and second derivatives of expressions, and the third derivative in one direction.

Forward-mode automatic differentiation: each step of an expression calculates its value, gradient and Hessian from those
of its arguments by the chain rule. Derivatives are in the first axes, points of evaluation in the last: value (...),
gradient (n, ...), Hessian (n, n, ...). A derivative that is zero everywhere is the number 0, which saves the Hessians
of sums of many inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from metrocli.expressions.expression import NEGATIVE, Expression, ExpressionError, Operation
from metrocli.frozen import dataclass

Array = npt.NDArray[Any]


class NoValueError(ExpressionError):
    """The model, or a derivative of it, has no value at the best estimates."""

    differentiable = False


@dataclass(frozen=True)
class Jet:
    """A value with its derivatives by n inputs."""

    value: Any
    gradient: Any
    """(n, ...)"""
    hessian: Any = None
    """(n, n, ...)"""
    along: Any = None
    """(n, n, ...): derivative of the Hessian along the direction"""


@dataclass(frozen=True)
class Jets:
    """The algebra of jets: names in the order of their derivatives; `order` 1 or 2, 3 with a direction (n,)."""

    expression: Expression
    names: Sequence[str]
    values: Mapping[str, Any]
    order: int = 2
    direction: Array | None = None

    def number(self, value: float) -> Jet:
        """Return a plain number: all its derivatives are 0."""
        return self._flat(value, 0.0)

    def name(self, part: Operation) -> Jet:
        """Return an input: its derivative by itself is 1."""
        value = self.values[part.name]
        if part.name not in self.names:
            return self._flat(value, 0.0)
        # one axis for each axis of the points, also for a value that is the same at all points
        points = (1,) * max(map(np.ndim, self.values.values()), default=0)
        unit = np.zeros(len(self.names))
        unit[self.names.index(part.name)] = 1.0
        return self._flat(value, unit.reshape(-1, *points))

    def _flat(self, value: Any, gradient: Any) -> Jet:
        """Return a jet without curvature; its value is a numpy number, since Python floats raise on overflow."""
        curved = 0.0 if self.order > 1 else None
        return Jet(np.asarray(value, dtype=float)[()], gradient, curved, 0.0 if self.direction is not None else None)

    def apply(self, part: Operation, arguments: Sequence[Jet]) -> Jet:
        """Return the outcome of one operation; raises NoValueError if it or a derivative is not finite."""
        with np.errstate(all="ignore"):
            jet = self._applied(part.operation, arguments)
        if not np.isfinite(jet.value).all():
            message = f"'{self.expression.source(part)}' has no value at the best estimates"
            raise NoValueError(message, part.start, "outside the range of the function, or a division by zero")
        if not all(np.isfinite(item).all() for item in (jet.gradient, jet.hessian, jet.along) if item is not None):
            message = f"'{self.expression.source(part)}' has no derivative at the best estimates"
            raise _not_differentiable(message, part.start)
        return jet

    def _applied(self, operation: str, arguments: Sequence[Jet]) -> Jet:
        first, second = arguments[0], arguments[-1]
        if operation in ("+", "-"):
            return _sum(first, second, 1.0 if operation == "+" else -1.0)
        if operation == NEGATIVE:
            return _scaled(first, -1.0)
        if operation == "*":
            return self._product(first, second)
        if operation == "/":
            return self._product(first, self._composed(second, _power(second.value, -1.0)))
        if operation == "**":
            return self._raised(first, second)
        if operation == "atan2":
            # atan2(y, x) is the imaginary part of log(x + i y), whose derivatives are regular in all directions
            argument = _sum(second, first, 1j)
            return _imaginary(self._composed(argument, _FUNCTIONS["log"](argument.value)))
        return self._composed(first, _FUNCTIONS[operation](first.value))

    def _raised(self, base: Jet, exponent: Jet) -> Jet:
        if np.ndim(exponent.value) == 0 and not np.any(exponent.gradient):
            return self._composed(base, _power(base.value, float(exponent.value)))
        logarithm = self._composed(base, _FUNCTIONS["log"](base.value))
        product = self._product(exponent, logarithm)
        return self._composed(product, _FUNCTIONS["exp"](product.value))

    def _along(self, derivative: Any) -> Any:
        assert self.direction is not None
        return np.tensordot(self.direction, derivative, (0, 0)) if np.ndim(derivative) else 0.0

    def _composed(self, x: Jet, derivatives: Sequence[Any]) -> Jet:
        """Return f(x) from f, f', f'', f''' at the value of x."""
        f0, f1, f2, f3 = derivatives
        gradient = _times(f1, x.gradient)
        if x.hessian is None:
            return Jet(f0, gradient)
        square = _outer(x.gradient, x.gradient)
        hessian = _times(f2, square) + _times(f1, x.hessian)
        if x.along is None:
            return Jet(f0, gradient, hessian)
        step, turn = self._along(x.gradient), self._along(x.hessian)
        turned = _both_ways(_outer(turn, x.gradient))
        along = _times(f3 * step, square) + _times(f2, turned + _times(step, x.hessian)) + _times(f1, x.along)
        return Jet(f0, gradient, hessian, along)

    def _product(self, x: Jet, y: Jet) -> Jet:
        gradient = _times(x.value, y.gradient) + _times(y.value, x.gradient)
        if x.hessian is None or y.hessian is None:
            return Jet(x.value * y.value, gradient)
        cross = _both_ways(_outer(x.gradient, y.gradient))
        hessian = _times(x.value, y.hessian) + _times(y.value, x.hessian) + cross
        if x.along is None or y.along is None:
            return Jet(x.value * y.value, gradient, hessian)
        turned = _outer(self._along(x.hessian), y.gradient) + _outer(x.gradient, self._along(y.hessian))
        along = _times(x.value, y.along) + _times(y.value, x.along) + _both_ways(turned)
        along = along + _times(self._along(x.gradient), y.hessian) + _times(self._along(y.gradient), x.hessian)
        return Jet(x.value * y.value, gradient, hessian, along)


def _not_differentiable(message: str, start: int) -> NoValueError:
    error = NoValueError(message, start, "first-order propagation does not apply here; Monte Carlo does")
    error.differentiable = True
    return error


def _times(factor: Any, derivative: Any) -> Any:
    """Return the product; a derivative that is the number 0 stays the number 0."""
    return factor * derivative if np.ndim(derivative) else 0.0


def _outer(a: Any, b: Any) -> Any:
    return a[:, None] * b[None, :] if np.ndim(a) and np.ndim(b) else 0.0


def _both_ways(matrix: Any) -> Any:
    return matrix + matrix.swapaxes(0, 1) if np.ndim(matrix) else 0.0


def _scaled(x: Jet, factor: Any) -> Jet:
    hessian = None if x.hessian is None else factor * x.hessian
    return Jet(factor * x.value, factor * x.gradient, hessian, None if x.along is None else factor * x.along)


def _sum(x: Jet, y: Jet, factor: Any) -> Jet:
    """Return x + factor y."""
    y = _scaled(y, factor)
    hessian = None if x.hessian is None or y.hessian is None else x.hessian + y.hessian
    along = None if x.along is None or y.along is None else x.along + y.along
    return Jet(x.value + y.value, x.gradient + y.gradient, hessian, along)


def _imaginary(x: Jet) -> Jet:
    hessian = None if x.hessian is None else np.imag(x.hessian)
    return Jet(np.imag(x.value), np.imag(x.gradient), hessian, None if x.along is None else np.imag(x.along))


def _power(x: Any, p: float) -> tuple[Any, ...]:
    """Return x**p and its derivatives; a factor 0 times an infinite power counts as 0, as for x**2 at 0."""
    factors, factor = [], 1.0
    for order in range(4):
        factors.append(factor * np.power(x, p - order) if factor else np.zeros_like(x))
        factor *= p - order
    return tuple(factors)


def _log(x: Any) -> tuple[Any, ...]:
    return np.log(x), 1 / x, -1 / x**2, 2 / x**3


def _tan(x: Any) -> tuple[Any, ...]:
    t = np.tan(x)
    s = 1 + t * t
    return t, s, 2 * t * s, s * (2 + 6 * t * t)


def _asin(x: Any) -> tuple[Any, ...]:
    w = 1 - x * x
    return np.arcsin(x), w**-0.5, x * w**-1.5, (1 + 2 * x * x) * w**-2.5


def _atan(x: Any) -> tuple[Any, ...]:
    w = 1 + x * x
    return np.arctan(x), 1 / w, -2 * x / w**2, (6 * x * x - 2) / w**3


def _tanh(x: Any) -> tuple[Any, ...]:
    t = np.tanh(x)
    s = 1 - t * t
    return t, s, -2 * t * s, s * (6 * t * t - 2)


_FUNCTIONS: dict[str, Callable[[Any], tuple[Any, ...]]] = {
    "sqrt": lambda x: _power(x, 0.5),
    "exp": lambda x: (np.exp(x),) * 4,
    "log": _log,
    "log10": lambda x: (np.log10(x), *(item / np.log(10.0) for item in _log(x)[1:])),
    "sin": lambda x: (np.sin(x), np.cos(x), -np.sin(x), -np.cos(x)),
    "cos": lambda x: (np.cos(x), -np.sin(x), -np.cos(x), np.sin(x)),
    "tan": _tan,
    "asin": _asin,
    "acos": lambda x: (np.arccos(x), *(-item for item in _asin(x)[1:])),
    "atan": _atan,
    "sinh": lambda x: (np.sinh(x), np.cosh(x)) * 2,
    "cosh": lambda x: (np.cosh(x), np.sinh(x)) * 2,
    "tanh": _tanh,
    "abs": lambda x: (np.abs(x), np.where(x == 0, np.nan, np.sign(x)), np.zeros_like(x), np.zeros_like(x)),
}
