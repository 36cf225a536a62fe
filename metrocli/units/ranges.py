"""What the quantities of a measurement can be: numbers outside are overload markers or mistakes, not readings."""

from __future__ import annotations

import math

from metrocli.arrays import Array, Mask
from metrocli.frozen import dataclass
from metrocli.units.parsing import find_unit, internal_unit
from metrocli.units.table import DIMENSIONS

_ROUNDING = 1e-12
LARGEST = 1e30
"""Largest number of any kind: squares of squares of larger ones overflow"""
SMALLEST = 1e-30
"""Smallest number above zero where zero is refused, such as a standard deviation: weights are squares of its inverse"""
OVERLOAD = 1e20
"""Instruments mark an overload by numbers above this (9.9e37 in SCPI)"""


@dataclass(frozen=True)
class Range:
    """The values that a quantity can have, in the internal unit of its dimension; both ends are allowed."""

    low: float
    high: float

    def excludes(self, values: Array) -> Mask:
        """Return which of the values are outside; nan is not."""
        import numpy as np

        slack = _ROUNDING * max(abs(self.low), abs(self.high))
        return np.asarray((values < self.low - slack) | (values > self.high + slack))

    def holds(self, value: float) -> bool:
        """Return whether one value is inside."""
        slack = _ROUNDING * max(abs(self.low), abs(self.high))
        return self.low - slack <= value <= self.high + slack


def up_to(size: float) -> Range:
    """Return the range of all values of at most this size."""
    return Range(-size, size)


_KILOMETRES, _TURNS, _YEARS, _PIXELS, _DEGREES = 10, 2, 3000, 1e7, 2000.0
_METRE, _HOUR = find_unit("m", "length").inside(1.0), find_unit("h", "time").inside(1.0)
_RANGES = {
    "length": up_to(_KILOMETRES * 1000 * _METRE),
    "angle": up_to(_TURNS * math.tau),
    "time": up_to(_YEARS * 366 * 24 * _HOUR),
    "temperature": Range(find_unit("K", "temperature").inside(0.0), _DEGREES),
    "temperature difference": up_to(_DEGREES),
    "pixel": up_to(_PIXELS),
    "speed": up_to(1000 * _METRE),
}


def range_of(dimension: str) -> Range:
    """Return what a quantity of a dimension can be: 10 km, two turns, 3000 years, ... ; any number up to LARGEST.

    Ranges are wide: they exclude what no instrument of dimensional metrology reads, not what is unlikely.
    """
    return _RANGES.get(dimension, up_to(LARGEST))


def in_words(allowed: Range, dimension: str, symbol: str = "") -> str:
    """Return a range in a unit of its dimension: "-720 to 720 deg"; the internal unit unless given."""
    if dimension not in DIMENSIONS:
        return f"{allowed.low:g} to {allowed.high:g}"
    unit = (
        find_unit(symbol or internal_unit(dimension), dimension) if symbol or internal_unit(dimension) != "1" else None
    )
    if unit is None:
        return f"{allowed.low:g} to {allowed.high:g}"
    low, high = round(unit.outside(allowed.low), 9), round(unit.outside(allowed.high), 9)
    return f"{low:.10g} to {high:.10g} {unit.symbol}"
