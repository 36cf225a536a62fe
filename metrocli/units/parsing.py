"""Convert text such as "20 arcsec" to a number in the internal unit; anything else is refused with a hint.

So are numbers that a quantity of a measurement cannot be: overload markers or mistakes, not readings.
"""

from __future__ import annotations

import math
import re

from metrocli.arrays import Array, Mask
from metrocli.frozen import dataclass
from metrocli.units.table import DIMENSIONS, INCH, Dimension, QuantityError, Unit

_INTERNAL = {"slope": "1", "ratio": "1"}
_SPELLINGS = {"\u00b5": "u", "\u03bc": "u", "°C": "degC", "°": "deg", "%": "percent", "\u03a9": "ohm", "\u2126": "ohm"}
"""Other spellings of units, including both micro signs and both ohm signs of Unicode."""
_NAMES = {"foot": "ft", "feet": "ft", "grad": "gon", "grads": "gon", "gradian": "gon", "gradians": "gon"}
_WORDS = {
    "micron": "um", "microns": "um", "micrometer": "um", "micrometre": "um", "millimeter": "mm", "millimetre": "mm",
    "meter": "m", "metre": "m", "degree": "deg", "degrees": "deg", "pixel": "px", "pixels": "px", "sec": "s",
    "second": "s", "seconds": "s", "minute": "min", "minutes": "min", "hour": "h", "as": "arcsec", "Mm": "mm",
    "MM": "mm", "C": "degC", "celsius": "degC", "'": "arcmin", "''": "arcsec", '"': "arcsec", "degs": "deg",
    "rads": "rad", "radian": "rad", "radians": "rad", "meters": "m", "metres": "m", "millimeters": "mm",
    "millimetres": "mm",
}  # fmt: skip
_INCHES = ("in", "inch", "inches")
_SYMBOL, _RESEMBLES = 2, 0.7
"""Longest symbol that is not compared with others, and similarity of words that are taken for each other"""
_OTHERS = ("mil", "thou", "mile", "yard")
"""Units of people that resemble known ones"""
_PREFIXES = "YZEPTGMkhdcmunpfaz"
"""Of the SI: with one of them a known unit is another unit, and no slip"""
_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_QUANTITY = re.compile(rf"({_NUMBER})\s*(.*)", re.DOTALL)
_COMMA = re.compile(r"([+-]?[0-9]*),([0-9]+)(.*)", re.DOTALL)
_ROUNDING = 1e-12
LARGEST = 1e30
"""Largest number of any kind: squares of squares of larger ones overflow"""
SMALLEST = 1e-30
"""Smallest number above zero where zero is refused, such as a standard deviation: weights are squares of its inverse"""
OVERLOAD = 1e20
"""Instruments mark an overload by numbers above this (9.9e37 in SCPI)"""


def internal_unit(dimension: str) -> str:
    """Return the internal unit of a dimension: the unit of its values in memory ("1" for slopes and ratios)."""
    return _INTERNAL.get(dimension, DIMENSIONS[dimension].unit)


def parse_quantity(text: str, dimension: str) -> float:
    """Return the value of a text such as "20 arcsec" in the internal unit of its dimension.

    Raises QuantityError, with a hint, if the text is not a number with a unit of this dimension.
    """
    wanted = DIMENSIONS[dimension]
    text = text.strip()
    match = _QUANTITY.fullmatch(text)
    comma = _COMMA.fullmatch(text)
    if comma and "." not in comma[3]:
        raise QuantityError(f"'{text}' has a decimal comma", f"write '{comma[1] or '0'}.{comma[2]}{comma[3]}'")
    if match is None:
        raise QuantityError(f"'{text}' is not a number with a unit", f"write e.g. '{wanted.example}'")
    number = float(match[1])
    if not math.isfinite(number):
        raise QuantityError(f"'{text}' is too large for a number", f"write e.g. '{wanted.example}'")
    if not match[2]:
        # a bare angle is one of a program that counts in rad or deg, seldom in the unit of the example
        unit = "rad' or '{} deg" if dimension == "angle" else wanted.example.split(" ", 1)[1]
        raise QuantityError(f"{text} has no unit", f"write e.g. '{match[1]} {unit.format(match[1])}'")
    return find_unit(match[2], dimension, match[1]).inside(number)


def find_unit(symbol: str, dimension: str, number: str = "1") -> Unit:
    """Return the unit with this symbol; other spellings (micro sign, degree sign, %) are accepted.

    Raises QuantityError, with a hint, if the symbol is not a unit of the dimension; `number` is used in the hint.
    """
    wanted = DIMENSIONS[dimension]
    plain = plain_symbol(symbol)
    for unit in wanted.units:
        if unit.symbol == plain:
            return unit
    accepted = f"allowed: {', '.join(wanted.symbols)}"
    if plain in ("degC", "K") and dimension.startswith("temperature"):
        raise QuantityError(f"'{symbol}' cannot be the unit of {wanted.phrase}", f"write '{number} {wanted.unit}'")
    if dimension == "length" and is_inch(plain):
        size = f"{float(number) * INCH:.12g}"
        raise QuantityError(
            f"'{symbol}' is the inch, which files cannot use", f"{number} inch is {size} mm: write '{size} mm'"
        )
    others = [other.phrase for other in DIMENSIONS.values() if plain in other.symbols]
    if others:
        raise QuantityError(f"'{symbol}' is the unit of {others[0]}, not of {wanted.phrase}", accepted)
    if not re.fullmatch(r"[^\W\d_]+(/[^\W\d_]+)*|1/[^\W\d_]+", plain):
        raise QuantityError(f"'{symbol}' after {number} is not one unit", f"write e.g. '{wanted.example}'")
    near = unit_meant(plain, wanted.symbols)
    raise QuantityError(f"unknown unit '{symbol}'", f"{near} {accepted}" if near else accepted)


def is_inch(symbol: str) -> bool:
    """Return whether a symbol stands for the inch, which files cannot use."""
    return plain_symbol(symbol).lower() in _INCHES


def plain_symbol(symbol: str) -> str:
    """Return a unit in the spelling of the table: "um" for "\u00b5m", "degC" for "\u00b0C", "percent" for "%"."""
    for typed, plain in _SPELLINGS.items():
        symbol = symbol.replace(typed, plain)
    symbol = symbol.strip()
    return _NAMES.get(symbol, symbol)


def unit_meant(word: str, known: tuple[str, ...]) -> str:
    """Return the question whether a known unit is meant, or nothing.

    Short symbols resemble each other and mean another quantity or size (`cl` and `ml`), so only words are compared. A
    known unit with a prefix or beside another one (`nrad`, `mPas`) is not that unit.
    """
    from difflib import get_close_matches

    parts = [_WORDS.get(part, part) for part in word.split("/")]
    meant = "/".join(parts)
    if meant not in known:
        symbols = {*known, *(symbol for dimension in DIMENSIONS.values() for symbol in dimension.symbols)}
        others = len(word) <= _SYMBOL or word in _OTHERS or len(parts) > 1 or _joined(word, symbols)
        meant = "" if others else next(iter(get_close_matches(word, known, 1, _RESEMBLES)), "")
    return f"did you mean '{meant}'?" if meant else ""


def _joined(word: str, symbols: set[str]) -> bool:
    """Return whether a word is a known symbol behind a prefix or another symbol."""
    return any(word[i:] in symbols and (word[:i] in symbols or word[:i] in _PREFIXES) for i in range(1, len(word)))


def quantity_pattern(dimension: str) -> str:
    """Return the regular expression (ECMA 262) of a quantity for the JSON schema of a job."""
    symbols = "|".join(sorted(_typed_forms(DIMENSIONS[dimension]), key=len, reverse=True))
    return rf"^\s*{_NUMBER}\s*({symbols})\s*$"


def _typed_forms(dimension: Dimension) -> set[str]:
    forms = set(dimension.symbols)
    for typed, plain in _SPELLINGS.items():
        forms |= {symbol.replace(plain, typed) for symbol in dimension.symbols if plain in symbol}
    return {form for form in forms if plain_symbol(form) in dimension.symbols}


def written_unit(text: str, dimension: str, word: str) -> str:
    """Return the unit in which the lines of a text with a word state quantities of a dimension, or "".

    Rates are also looked for in the other lines, except in units that quantities of another kind share, as percent.
    Comments of YAML are not searched.
    """
    lines = [line.partition("#")[0] for line in text.splitlines()]
    named = [line for line in lines if re.search(rf"\b{re.escape(word)}\b", line)]
    own = _stated(named, DIMENSIONS[dimension])
    if own or "/" not in DIMENSIONS[dimension].unit:
        return next(iter(own), "")
    shared = {
        s for symbols in DIMENSIONS.values() if symbols.unit != DIMENSIONS[dimension].unit for s in symbols.symbols
    }
    return next((symbol for symbol in _stated(lines, DIMENSIONS[dimension]) if symbol not in shared), "")


def as_stated(value: float, unit: str, condition: str) -> tuple[float, str]:
    """Return a value in an internal unit in the unit that a condition such as "< 100 nm" states, and that unit."""
    for dimension in DIMENSIONS.values():
        if internal_unit(dimension.name) == unit:
            for symbol in _stated([condition], dimension):
                return find_unit(symbol, dimension.name).outside(value), symbol
    return value, unit


def _stated(lines: list[str], dimension: Dimension) -> list[str]:
    forms = "|".join(re.escape(form) for form in sorted(_typed_forms(dimension), key=len, reverse=True))
    quantity = re.compile(rf"(?<![\w.]){_NUMBER}\s*({forms})(?![\w/])")
    return [plain_symbol(match) for line in lines for match in quantity.findall(line)]


def suffixes(dimension: str) -> dict[str, Unit]:
    """Return the units of a dimension by the ending of a CSV column's name: {"mm": ..., "um_per_m": ...}."""
    return {_suffix(unit.symbol): unit for unit in DIMENSIONS[dimension].units}


def _suffix(symbol: str) -> str:
    return symbol.replace("1/", "per_").replace("/", "_per_")


def suffix_of(unit: str) -> str:
    """Return the ending of the name of a CSV column with this internal unit; empty for a plain number."""
    return "" if unit in ("", "1") else _suffix(unit)


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
