"""Format quantities for reports: rounded to their uncertainty, in a unit that suits their size."""

from __future__ import annotations

import math

from metrocli.units.parsing import find_unit, internal_unit
from metrocli.units.table import DIMENSIONS, KILO

NOT_DETERMINED = "not determined"
"""Stands for a value that is not finite, or whose standard uncertainty is not"""
SPREAD = "± standard uncertainty"
"""What "12.3457 ± 0.0012" means, for the heading or the sentence that has it"""
_LADDERS = {
    "mm": ("length", ("mm", "um", "nm")),
    "rad": ("angle", ("rad", "mrad", "urad")),
    "mm/s": ("speed", ("mm/s", "um/min", "um/h")),
    "1/s": ("rate", ("1/s", "1/h", "ppm/h")),
    "1/K": ("expansion", ("1/K", "ppm/K")),
}
"""Units of columns by their internal unit: its dimension, and the units that differ by powers of ten or of time"""
_SMALL = 0.1
"""A column whose largest number is smaller is shown in a smaller unit"""
_LEVEL = 1e-6
"""Difference [rad] of an angle and its slope that nobody reads"""


def rounded(value: float, std: float) -> tuple[str, str]:
    """Return value and standard uncertainty as text, both rounded to two digits of the uncertainty (GUM 7.2.6).

    Both are "not determined" if one of them is not finite.
    """
    if not (math.isfinite(value) and math.isfinite(std)):
        return NOT_DETERMINED, NOT_DETERMINED
    if std <= 0:
        return f"{value:.10g}", "0" if std == 0 else f"{std:.2g}"
    digits = 1 - math.floor(math.log10(float(f"{std:.1e}")))
    if not -6 <= digits <= 12:
        return f"{value:.{max(1, _significant(value, std))}e}", f"{std:.1e}"
    if digits < 0:
        return f"{round(value, digits):.0f}", f"{round(std, digits):.0f}"
    return f"{value:z.{digits}f}", f"{std:.{digits}f}"


def _significant(value: float, std: float) -> int:
    """Return the decimals that a value in scientific notation needs to show two digits of its uncertainty."""
    return 1 if value == 0 else math.floor(math.log10(abs(value))) - math.floor(math.log10(std)) + 1


def with_std(value: float, std: float) -> str:
    """Return a value and its standard uncertainty as "12.3457 ± 0.0012", or "not determined"; without ± if it is 0."""
    number, spread = rounded(value, std)
    return number if number == NOT_DETERMINED or std == 0 else f"{number} ± {spread}"


def format_quantity(value: float, unit: str, std: float | None = None) -> str:
    """Return a value as text: "12.3457 ± 0.0012 mm", with two digits of the standard uncertainty."""
    unit = "" if unit in ("", "1") else f" {unit}"
    if not math.isfinite(value):
        return NOT_DETERMINED
    shown = f"{value:.6g}" if std is None else with_std(value, std)
    return shown if shown == NOT_DETERMINED else f"{shown}{unit}"


def readable(value: float, dimension: str) -> tuple[float, str]:
    """Return a value and the unit of its dimension in which the number is nearest to 3 on a logarithmic scale."""
    if not dimension:
        return value, ""
    reported = [unit for unit in DIMENSIONS[dimension].units if unit.reported and not unit.offset]
    if value == 0 or not math.isfinite(value):
        # a ratio has no internal unit that a file may use
        own = internal_unit(dimension)
        return value, own if own in DIMENSIONS[dimension].symbols else reported[0].symbol
    return _nearest_to_3(value, dimension, tuple(unit.symbol for unit in reported))


def _nearest_to_3(value: float, dimension: str, symbols: tuple[str, ...]) -> tuple[float, str]:
    scaled = [(find_unit(symbol, dimension).outside(value), symbol) for symbol in symbols]
    return min(scaled, key=lambda choice: abs(math.log10(abs(choice[0])) - 0.5))


def column_unit(largest: float, unit: str) -> tuple[float, str]:
    """Return the unit for a column whose largest number in an internal unit is this, and its size in internal units.

    It is the internal unit unless all numbers in it are small: lengths below 0.1 mm are shown in um or nm.
    """
    if unit not in _LADDERS or not 0 < abs(largest) < _SMALL:
        return 1.0, unit
    dimension, symbols = _LADDERS[unit]
    symbol = _nearest_to_3(largest, dimension, symbols)[1]
    return find_unit(symbol, dimension).inside(1.0), symbol


def two_digits(value: float) -> str:
    """Return a number to two digits, for sentences: "0.21", "100"."""
    return f"{float(f'{value:.2g}'):g}" if math.isfinite(value) else NOT_DETERMINED


def chance(p: float) -> str:
    """Return a probability as `p = 0.012`; below 1e-12 its size means nothing."""
    return "p < 1e-12" if p < 1e-12 else f"p = {p:.2g}"


def sized(value: float, dimension: str) -> str:
    """Return a quantity to two digits in the unit that suits its size, for sentences: "0.21 um"."""
    size, symbol = readable(value, dimension)
    return f"{two_digits(size)} {'' if symbol == '1' else symbol}".strip() if math.isfinite(size) else NOT_DETERMINED


_ROUNDING = 1e-10
"""Smaller changes of a result, in internal units, are those of the arithmetic"""


def changed_by(value: float, dimension: str) -> str:
    """Return a change of a result as `sized` does, but not the change that rounding makes."""
    return "below rounding" if abs(value) < _ROUNDING else sized(value, dimension)


def roughly(value: float, unit: str) -> str:
    """Return a length (mm) to two digits in another unit, for sentences: "0.21 um"."""
    number = two_digits(find_unit(unit, "length").outside(value))
    return number if number == NOT_DETERMINED else f"{number} {unit}"


def as_slope(angle: float, std: float) -> tuple[float, float, str]:
    """Return an angle and its standard uncertainty (rad) as a slope in mm/m, the usual form for machine tools.

    An angle that differs from its slope (tangent) by more than its uncertainty is returned in degrees.
    """
    if abs(math.tan(angle) - angle) > max(std, _LEVEL):
        return math.degrees(angle), math.degrees(std), "deg"
    return angle * KILO, std * KILO, "mm/m"
