"""Quantities for people: rounded to their uncertainty, in the unit that suits their size."""

from __future__ import annotations

import math

from metrocli.units.parsing import find_unit, internal_unit
from metrocli.units.table import DIMENSIONS, KILO


def rounded(value: float, std: float) -> tuple[str, str]:
    """Return value and standard uncertainty as text, both to the second digit of the uncertainty."""
    if not (math.isfinite(value) and math.isfinite(std)) or std <= 0:
        return f"{value:.10g}", "0" if std == 0 else f"{std:.2g}"
    digits = 1 - math.floor(math.log10(float(f"{std:.1e}")))
    if not -6 <= digits <= 12:
        return f"{value:.{max(1, _significant(value, std))}e}", f"{std:.1e}"
    if digits < 0:
        return f"{round(value, digits):.0f}", f"{round(std, digits):.0f}"
    return f"{value:.{digits}f}", f"{std:.{digits}f}"


def _significant(value: float, std: float) -> int:
    """Digits after the point that a value in scientific notation needs to show two digits of its uncertainty."""
    return 1 if value == 0 else math.floor(math.log10(abs(value))) - math.floor(math.log10(std)) + 1


def format_quantity(value: float, unit: str, std: float | None = None) -> str:
    """Return a value for people: "12.3457 ± 0.0012 mm", two digits of the standard uncertainty."""
    unit = "" if unit in ("", "1") else f" {unit}"
    if std is None:
        return f"{value:.6g}{unit}"
    number, spread = rounded(value, std)
    return f"{number} ± {spread}{unit}"


def readable(value: float, dimension: str) -> tuple[float, str]:
    """Return a value in the unit of its dimension in which it is a number from 1 to 1000, or nearest to that."""
    if not dimension or value == 0 or not math.isfinite(value):
        return value, internal_unit(dimension) if dimension else ""
    found = [(unit.outside(value), unit.symbol) for unit in DIMENSIONS[dimension].units if not unit.offset]
    return min(found, key=lambda one: abs(math.log10(abs(one[0])) - 0.5))


def two_digits(value: float) -> str:
    """Return a number to two digits, for sentences: "0.21", "100"."""
    return f"{float(f'{value:.2g}'):g}"


def roughly(value: float, unit: str) -> str:
    """Return a length (mm) to two digits in another unit, for sentences: "0.21 um"."""
    return f"{two_digits(find_unit(unit, 'length').outside(value))} {unit}"


def as_slope(angle: float) -> tuple[float, str]:
    """Return a small angle (rad) as the slope people read on a machine, in mm/m."""
    return angle * KILO, "mm/m"
