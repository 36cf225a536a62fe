"""User-defined effects that are tried before a job uses them: laws, and definitions on sample readings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Link, LinkContext, Step
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array
from metrocli.effects.acting import Acting, Variable
from metrocli.effects.effect import Effect, Parameter
from metrocli.expressions.derivatives import Jets, NoValueError
from metrocli.expressions.expression import Expression, ExpressionError
from metrocli.frozen import dataclass

_N = 16
_STEP = 1e-3
"""Step of the differences, as a share of the plausible size"""
_AGREES = 1e-6
_SAMPLE = {"axis": "x", "pair": "xy"}


class _Conditions(dict[str, Array]):
    """Conditions of readings: any name has values, between 0.1 and 1."""

    def __missing__(self, name: str) -> Array:
        self[name] = np.random.default_rng(len(self)).uniform(0.1, 1.0, _N)
        return self[name]


def broken(effect: Effect, places: Sequence[Acting]) -> Iterator[str]:
    """Yield a sentence for each law that an effect breaks, for a kind of job with these places to act."""
    for what in ("cause", "source", "reveal"):
        if not getattr(effect, what) and not effect.definition:
            yield f"it has no {what}"
    if not all(parameter.plausible > 0 for parameter in effect.parameters):
        yield "a plausible size is not above zero"
    if effect.link is None:
        return
    link = effect.link("own", {key: _name(key, places) for key in effect.keys})
    size = next((len(place.components) for place in places if place.quantity is link.takes), 0)
    if link.takes is not link.gives or not size:
        yield f"it acts on {link.takes.value if link.takes else 'nothing'}, which this kind of job does not have"
    elif tuple(link.blocks) == ("own",):
        yield from _of_link(effect, link, size)


def _name(key: str, places: Sequence[Acting]) -> str:
    split = next((place.split[key] for place in places if key in place.split), {})
    return _SAMPLE.get(key) or next(iter(split), key)


def _of_link(effect: Effect, link: Link, size: int) -> Iterator[str]:
    value = np.random.default_rng(3).uniform(0.2, 0.9, (size, _N))
    conditions = _Conditions()
    plain = {parameter.name: 0.5 * parameter.plausible for parameter in effect.parameters}
    scanned = {parameter.name: _middle(parameter, conditions) for parameter in effect.scanned}

    def step(sizes: Mapping[str, float], at: Array = value, move: Array | None = None) -> Step:
        row = np.array([[*sizes.values(), *scanned.values()]])
        names = tuple(parameter.name for parameter in effect.all_parameters)
        block = Block("own", row, names, space=effect.space)
        block = block if move is None else block.moved(move)
        observations = Observations(np.zeros((size, _N)), np.ones(1), conditions=conditions)
        return link.step(at, LinkContext({"own": block}, observations, frozenset({"own"})))

    if not np.allclose(step(dict.fromkeys(plain, 0.0)).value, value, rtol=0, atol=1e-12):
        yield "it is not 0 where all its parameters are 0"
    here = step(plain)
    for number, parameter in enumerate(effect.parameters):
        move = np.zeros((1, len(effect.all_parameters)))
        move[0, number] = _STEP * parameter.plausible
        change = (step(plain, move=move).value - step(plain, move=-move).value) / (2 * move[0, number])
        stated = np.broadcast_to(here.by_block["own"][:, number], change.shape)
        if not np.abs(change).max() > 0:
            yield f"its parameter '{parameter.name}' changes nothing"
        elif np.abs(change - stated).max() > 1e3 * _STEP**2 * np.abs(change).max() + _AGREES * np.abs(change).max():
            yield f"its derivative by '{parameter.name}' is not that of its values"
    for number in range(size):
        move = np.zeros((size, 1))
        move[number] = _STEP
        change = (step(plain, value + move).value - step(plain, value - move).value) / (2 * _STEP)
        by_input = np.zeros((size, size, 1)) if here.by_input is None else here.by_input
        stated = np.broadcast_to(by_input[:, number], change.shape)
        if np.abs(change - stated).max() > 1e3 * _STEP**2 + _AGREES:
            yield "its derivative by the quantity on which it acts is not that of its values"
            return


def _middle(parameter: Parameter, conditions: Mapping[str, Array]) -> float:
    if parameter.grid is None:
        return 1.0
    values = parameter.grid(conditions)
    return float(values[len(values) // 2])


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
        there, at_zero = (
            [gradients(expression, values) for expression in expressions],
            [gradients(expression, zero) for expression in expressions],
        )
        vanishes = all(
            np.abs(none[0]).max() <= _ZERO * max(float(np.abs(some[0]).max()), 1e-300)
            for none, some in zip(at_zero, there, strict=True)
        )
        return cls(expressions, values, vanishes, _moving(there), _moving(at_zero) & set(parameters))

    def has_value_at(self, name: str, value: float) -> bool:
        """Return whether all expressions have values where one of the names has a given value."""
        try:
            return bool(
                [
                    gradients(expression, {**self.values, name: np.full(_DRAWS, value)})
                    for expression in self.expressions
                ]
            )
        except NoValueError:
            return False


def gradients(expression: Expression, values: Mapping[str, Array]) -> tuple[Array, dict[str, Array]]:
    """Return the value of an expression (draws,) and its derivatives by name; raises NoValueError."""
    names = expression.names
    jet = expression.carried_out(Jets(expression, names, values, order=1))
    value = np.broadcast_to(jet.value, (_DRAWS,))
    by = np.broadcast_to(jet.gradient if np.ndim(jet.gradient) else 0.0, (len(names), _DRAWS)) if names else ()
    return value, dict(zip(names, by, strict=True))


def _moving(linearised: Sequence[tuple[Array, dict[str, Array]]]) -> frozenset[str]:
    return frozenset(name for _, by in linearised for name, values in by.items() if np.abs(values).max() > 0)


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
