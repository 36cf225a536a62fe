"""A user-defined effect: expressions in parameters and variables are added to components of a quantity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import AtQuantity
from metrocli.arrays import Array
from metrocli.effects.acting import Variable
from metrocli.errors import InputError
from metrocli.expressions.derivatives import Jets, NoValueError
from metrocli.expressions.expression import Expression
from metrocli.frozen import dataclass


class NoValueAtReadingError(InputError):
    """A user-defined effect has no value, or no derivative, at a reading."""


@dataclass(frozen=True)
class OwnTerms(AtQuantity):
    """Terms of one's own: `q_i += f_i(p, v)` for some components i; columns p, then the scanned ones.

    The variables v may be components of q itself and may depend on other blocks. All derivatives are exact: those of
    f_i by p and v (`Jets`), then by the chain rule. If the first two parameters are amplitude and phase of a wave
    (`wave`), derivatives are taken along the phasor and across it (`Space.WAVE`).
    """

    name: str
    """Name of the effect, for messages"""
    terms: tuple[tuple[int, Expression], ...]
    """Component and what is added to it"""
    parameters: tuple[str, ...]
    scanned: tuple[str, ...]
    variables: tuple[Variable, ...]
    wave: bool = False

    @property
    def blocks(self) -> tuple[str, ...]:
        """The blocks on which its variables depend, and its own block."""
        return (*dict.fromkeys(name for variable in self.variables for name in variable.blocks), self.block)

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the quantity (d, n); raises NoValueAtReadingError if an expression has no value at a reading."""
        d, n = len(value), local.observations.count
        rows, last = local.rows(self.block), local.members(self.block)[-1]
        known = {variable.name: variable.at(value, local) for variable in self.variables}
        values = {name: step.value[0] for name, step in known.items()}
        values |= {name: rows[number] for number, name in enumerate(self.parameters)}
        # the row for readings elsewhere has no scanned values; those of the places are the same at all of them
        values |= dict(zip(self.scanned, last[len(self.parameters) :], strict=True))
        moved = np.array(np.broadcast_to(value, (d, n)))
        by_input = np.array(np.broadcast_to(np.eye(d)[:, :, None], (d, d, n)))
        by_block = {self.block: np.zeros((d, local.blocks[self.block].size, n))}
        by_block |= {name: np.zeros((d, local.blocks[name].size, n)) for name in self.blocks if name != self.block}
        for number, expression in self.terms:
            gradient = self._evaluated(expression, values, local.observations)
            moved[number] += gradient.value
            for column, name in enumerate(self.parameters):
                by_block[self.block][number, column] = gradient.by.get(name, 0.0)
            if self.wave:
                across = self._evaluated(expression, values | {self.parameters[0]: np.ones(1)}, local.observations)
                by_block[self.block][number, 1] = across.by[self.parameters[1]]
            for name, step in known.items():
                if name not in gradient.by:
                    continue
                if step.by_input is not None:
                    by_input[number] += gradient.by[name] * step.by_input[0]
                for block, inner in step.by_block.items():
                    by_block[block][number] += gradient.by[name] * inner[0]
        return Step(moved, by_input, by_block)

    def _evaluated(self, expression: Expression, values: dict[str, Array], observations: Observations) -> _Gradient:
        used = [name for name in expression.names if name not in self.scanned]
        try:
            jet = expression.carried_out(Jets(expression, used, values, order=1))
        except NoValueError as error:
            at = _named(observations, _first_without(expression, used, values, observations.count))
            what = f"{self.name}: {error.message.replace(' at the best estimates', '')} at {at}"
            hint = (
                "it has a corner or a step there, which has to lie between readings"
                if error.differentiable
                else error.hint
            )
            raise NoValueAtReadingError(f"{what}; {hint}") from error
        gradient = np.broadcast_to(jet.gradient, (len(used), *np.shape(jet.gradient)[1:])) if used else ()
        return _Gradient(jet.value, dict(zip(used, gradient, strict=True)))


def _first_without(expression: Expression, used: Sequence[str], values: Mapping[str, Array], count: int) -> int:
    """Return the first of the readings at which an expression that lacks a value somewhere has none."""
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        part = {name: given[low:middle] if np.shape(given) == (count,) else given for name, given in values.items()}
        try:
            expression.carried_out(Jets(expression, used, part, order=1))
        except NoValueError:
            high = middle
        else:
            low = middle
    return low


def _named(observations: Observations, number: int) -> str:
    """Return the keys of a reading in words; parts of a large adjustment have none."""
    keys = [f"{key} {names[number]}" for key, names in observations.keys.items()]
    return f"the reading {', '.join(keys)}" if keys else "a reading"


@dataclass(frozen=True)
class _Gradient:
    """Value of an expression at the readings, and its derivatives by name."""

    value: Array
    by: dict[str, Array]
