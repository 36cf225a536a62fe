"""Format quantities for reports: rounded to their uncertainty, in a unit that suits their size."""

from __future__ import annotations

import math

from metrocli.units.parsing import find_unit, internal_unit
from metrocli.units.table import DIMENSIONS, KILO


def rounded(value: float, std: float) -> tuple[str, str]:
    """Return value and standard uncertainty as text, both rounded to two digits of the uncertainty (GUM 7.2.6)."""
    if not (math.isfinite(value) and math.isfinite(std)) or std <= 0:
        return f"{value:.10g}", "0" if std == 0 else f"{std:.2g}"
    digits = 1 - math.floor(math.log10(float(f"{std:.1e}")))
    if not -6 <= digits <= 12:
        return f"{value:.{max(1, _significant(value, std))}e}", f"{std:.1e}"
    if digits < 0:
        return f"{round(value, digits):.0f}", f"{round(std, digits):.0f}"
    return f"{value:.{digits}f}", f"{std:.{digits}f}"


def _significant(value: float, std: float) -> int:
    """Return the decimals that a value in scientific notation needs to show two digits of its uncertainty."""
    return 1 if value == 0 else math.floor(math.log10(abs(value))) - math.floor(math.log10(std)) + 1


def format_quantity(value: float, unit: str, std: float | None = None) -> str:
    """Return a value as text: "12.3457 ± 0.0012 mm", with two digits of the standard uncertainty."""
    unit = "" if unit in ("", "1") else f" {unit}"
    if std is None:
        return f"{value:.6g}{unit}"
    number, spread = rounded(value, std)
    return f"{number} ± {spread}{unit}"


def readable(value: float, dimension: str) -> tuple[float, str]:
    """Return a value and the unit of its dimension in which the number is nearest to 3 on a logarithmic scale."""
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
    """Return a small angle (rad) as a slope in mm/m, the usual form for machine tools."""
    return angle * KILO, "mm/m"
