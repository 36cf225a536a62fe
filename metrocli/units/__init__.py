"""Units: the closed table of units, and conversion from text to quantities and back. No other package converts."""

from metrocli.units.parsing import (
    find_unit,
    internal_unit,
    is_inch,
    nearest,
    parse_quantity,
    plain_symbol,
    quantity_pattern,
    suffix_of,
    suffixes,
)
from metrocli.units.people import as_slope, format_quantity, readable, roughly, rounded, two_digits
from metrocli.units.ranges import LARGEST, OVERLOAD, SMALLEST, Range, in_words, range_of, up_to
from metrocli.units.table import DIMENSIONS, INCH, Dimension, QuantityError, Unit

__all__ = [
    "DIMENSIONS",
    "INCH",
    "LARGEST",
    "OVERLOAD",
    "SMALLEST",
    "Dimension",
    "QuantityError",
    "Range",
    "Unit",
    "as_slope",
    "find_unit",
    "format_quantity",
    "in_words",
    "internal_unit",
    "is_inch",
    "nearest",
    "parse_quantity",
    "plain_symbol",
    "quantity_pattern",
    "range_of",
    "readable",
    "roughly",
    "rounded",
    "suffix_of",
    "suffixes",
    "two_digits",
    "up_to",
]
