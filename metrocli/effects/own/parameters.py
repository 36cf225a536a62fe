"""Parameters and components of an effect of one's own, from the words of its definition."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli import units
from metrocli.adjust.model.blocks import Array
from metrocli.effects.acting import ALONG, Acting
from metrocli.effects.effect import Parameter
from metrocli.effects.own.definition import Scan
from metrocli.expressions.dimensions import Compound, base_unit
from metrocli.expressions.expression import NAME
from metrocli.expressions.written import Model

_FINER = 100
"""Values by which the best one of a scan is refined, in one of its steps"""
_NOT_MEANT = ("wavelength", "temperature", "slope", "humidity", "frequency")
"""Dimensions that share their units with the one that a parameter has"""


def components(acting: Acting, where: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the components that an effect with these kinds of place can change."""
    along = (ALONG,) if "axis" in where and "axis" in acting.where and len(acting.components) > 1 else ()
    return (*acting.components, *along)


def shape(components: Sequence[str]) -> str:
    """Return how `adds` is written for a quantity with these components, for messages."""
    if components == ("",):
        return "adds: EXPRESSION"
    return f"adds: {{{components[0]}: EXPRESSION}}; components: {', '.join(components)}"


def of_unit(
    name: str,
    text: str,
    unit: Compound | None,
    plausible: float,
    grid: Callable[[Mapping[str, Array]], Array] | None = None,
    tried: int = 120,
) -> Parameter:
    """Return a parameter with the dimension of its unit, or with base units if no dimension has that unit."""
    symbol = units.plain_symbol(text.strip())
    if unit is None or symbol in ("", "1"):
        return Parameter(name, "", plausible, grid=grid, tried=tried)
    for dimension in units.DIMENSIONS.values():
        if symbol in dimension.symbols and dimension.coherent == 1.0 and dimension.name not in _NOT_MEANT:
            return Parameter(name, dimension.name, plausible, grid=grid, tried=tried)
    plain = Parameter(name, "", plausible, grid=grid, tried=tried, base=_base_unit(unit))
    return replace(plain, shown=text.strip(), given=unit.factor)


def _base_unit(unit: Compound) -> str:
    """Return a unit in base units with negative powers last: mm s-2."""
    return base_unit(tuple(sorted(unit.powers, key=lambda power: power[1] < 0)))


def values_tried(name: str, scan: Scan, adds: Iterable[Model]) -> Array:
    """Return the values of a scan, even in 1/value for a name that only divides, such as a period, else even.

    Between those that are tried are those by which the best one is refined.
    """
    low, high, count = scan.low.value, scan.high.value, (scan.steps - 1) * _FINER + 1
    if low > 0 and all(_only_divides(model, name) for model in adds):
        return np.asarray(1 / np.linspace(1 / high, 1 / low, count))
    return np.linspace(low, high, count)


def _only_divides(model: Model, name: str) -> bool:
    """Return whether a name occurs in an expression only behind a division sign, as the period of a wave does."""
    text = model.expression.text
    named = [part for part in model.expression.parts if part.operation == NAME and part.name == name]
    return all(text[: part.start].rstrip().endswith("/") for part in named)
