"""Trial values of an effect of one's own: whether it vanishes at 0, what each parameter changes, and waves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.effects.acting import Variable
from metrocli.expressions.derivatives import Jets, NoValueError
from metrocli.expressions.expression import Expression, ExpressionError
from metrocli.frozen import dataclass

_DRAWS = 64
_ZERO = 1e-12
"""Share of the largest value below which a value is a rounding error"""
_REACHES = ((0.1, 1.0), (-1.0, 1.0), (1.0, 1000.0), (-1000.0, 1000.0))
"""Ranges of the variables that are tried in turn: some expressions have no value for negative or for large ones"""


@dataclass(frozen=True)
class Trial:
    """What some expressions do at random values of their variables."""

    expressions: tuple[Expression, ...]
    values: Mapping[str, Array]
    """Values of variables, parameters and scanned parameters, (draws,)"""
    vanishes: bool
    """Whether they are 0 where all parameters are 0"""
    moving: frozenset[str]
    """Names that change at least one of them"""
    moving_at_zero: frozenset[str]
    """Parameters that change one of them where all parameters are 0"""

    @classmethod
    def of(
        cls,
        expressions: Sequence[Expression],
        variables: Mapping[str, Variable],
        plausible: Mapping[str, float],
        scanned: Mapping[str, tuple[float, float]],
    ) -> Trial:
        """Return the trial in the first range of the variables in which all have values; raises NoValueError."""
        rng = np.random.default_rng(17)
        own = {name: size * rng.uniform(0.3, 1.0, _DRAWS) for name, size in plausible.items()}
        own |= {name: rng.uniform(*ends, _DRAWS) for name, ends in scanned.items()}
        for reach in _REACHES:
            drawn = {name: rng.uniform(*reach, _DRAWS) for name in variables}
            with suppress(NoValueError):
                return cls._at(tuple(expressions), {**drawn, **own}, tuple(plausible))
        return cls._at(tuple(expressions), {**drawn, **own}, tuple(plausible))

    @classmethod
    def _at(cls, expressions: tuple[Expression, ...], values: dict[str, Array], parameters: tuple[str, ...]) -> Trial:
        zero = values | {name: np.zeros(_DRAWS) for name in parameters}
        there, at_zero = [gradients(one, values) for one in expressions], [gradients(one, zero) for one in expressions]
        vanishes = all(
            np.abs(none[0]).max() <= _ZERO * max(float(np.abs(some[0]).max()), 1e-300)
            for none, some in zip(at_zero, there, strict=True)
        )
        return cls(expressions, values, vanishes, _moving(there), _moving(at_zero) & set(parameters))

    def has_value_at(self, name: str, value: float) -> bool:
        """Return whether all expressions have values where one of the names has a given value."""
        try:
            return bool([gradients(one, {**self.values, name: np.full(_DRAWS, value)}) for one in self.expressions])
        except NoValueError:
            return False


def gradients(expression: Expression, values: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
    """Return the value of an expression (draws,) and its derivatives by name; raises NoValueError."""
    names = expression.names
    jet = expression.carried_out(Jets(expression, names, values, order=1))
    value = np.broadcast_to(jet.value, (_DRAWS,))
    by = np.broadcast_to(jet.gradient if np.ndim(jet.gradient) else 0.0, (len(names), _DRAWS)) if names else ()
    return value, dict(zip(names, by, strict=True))


def _moving(found: Sequence[tuple[Array, dict[str, Array]]]) -> frozenset[str]:
    return frozenset(name for _, by in found for name, values in by.items() if np.abs(values).max() > 0)


def is_wave(trial: Trial, parameters: Sequence[str], still: Sequence[str]) -> tuple[str, str] | None:
    """Return amplitude and phase if the expressions are `a w(phase)` with `w'' = -w`, else None.

    `still` are the parameters that change nothing where all are 0; a phase is one of them.
    """
    if len(still) != 1 or len(parameters) != 2:
        return None
    phase, amplitude = still[0], next(name for name in parameters if name not in still)
    for expression in trial.expressions:
        jet = expression.carried_out(Jets(expression, (amplitude, phase), trial.values, order=2))
        hessian = np.broadcast_to(jet.hessian if np.ndim(jet.hessian) else 0.0, (2, 2, _DRAWS))
        size = float(np.abs(jet.value).max())
        along = np.abs(hessian[0, 0]).max() * trial.values[amplitude].max() ** 2
        if np.abs(hessian[1, 1] + jet.value).max() > 1e-9 * size or along > 1e-9 * size:
            return None
    return amplitude, phase


def without_value(error: NoValueError) -> ExpressionError:
    """Return what is wrong with an expression that has no value, or no derivative, at all values that were tried."""
    if not error.differentiable:
        hint = "a root, logarithm or division outside its range"
        return ExpressionError("has no value for any of the values that were tried", 0, hint)
    hint = "an effect grows in proportion to small parameters; it contains no root or absolute value of them"
    return ExpressionError("has no derivative where all parameters are 0", 0, hint)
