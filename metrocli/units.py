"""The closed table of units: the only place where "20 arcsec" becomes a number, and back.

Inside the program: millimetre, radian, second, pixel, degree Celsius, kelvin for differences, hectopascal, percent of
relative humidity, 1 for ratios and slopes. A unit that is not in the table is refused, never reinterpreted.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

_PI = math.pi
_ARCSEC_PER_TURN = 1_296_000.0
_KELVIN_AT_0_DEGC = 273.15
INCH = 25.4
"""Millimetres; not a unit of files here, but one that they are written in by mistake"""


@dataclass(frozen=True)
class Unit:
    """One unit of one dimension: internal value = number * times / over + offset."""

    symbol: str
    times: float = 1.0
    over: float = 1.0
    offset: float = 0.0

    def inside(self, number: float) -> float:
        """Return a number in this unit as its internal value, rounded once where the factor is a power of ten."""
        return number * self.times / self.over + self.offset

    def outside(self, value: float) -> float:
        """Return an internal value as a number in this unit."""
        return (value - self.offset) * self.over / self.times

    def array_inside(self, numbers: Array) -> Array:
        """Return a whole column in internal values; the column itself where nothing changes."""
        if self.times == 1.0 and self.over == 1.0 and self.offset == 0.0:
            return numbers
        return numbers * self.times / self.over + self.offset


@dataclass(frozen=True)
class Dimension:
    """A kind of quantity: its units (the first is the internal one) and an example for messages."""

    name: str
    phrase: str
    example: str
    units: tuple[Unit, ...]
    powers: str = ""
    """Powers of the base units mm, s, kg, A, K, px, mol, cd of which it is made: "mm s-1"; "" for a plain number."""
    coherent: float = 1.0
    """Value of the internal unit in those base units."""

    @property
    def unit(self) -> str:
        """The internal unit."""
        return self.units[0].symbol

    @property
    def symbols(self) -> tuple[str, ...]:
        """The units that a file may use."""
        return tuple(unit.symbol for unit in self.units)


class QuantityError(ValueError):
    """A text is not a quantity of the dimension asked for; `hint` says what to write."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


_KILO, _MILLION, _BILLION = 1e3, 1e6, 1e9
_LENGTHS = (Unit("mm"), Unit("m", _KILO), Unit("um", over=_KILO), Unit("nm", over=_MILLION))
_SLOPES = (Unit("1"), Unit("mm/m", over=_KILO), Unit("um/m", over=_MILLION), Unit("nm/m", over=_BILLION))
_SCALES = (Unit("percent", over=100.0), Unit("ppm", over=_MILLION), Unit("ppb", over=_BILLION))
_ANGLES = (
    Unit("rad"),
    Unit("mrad", over=_KILO),
    Unit("urad", over=_MILLION),
    Unit("deg", _PI, 180.0),
    Unit("arcmin", 2 * _PI, _ARCSEC_PER_TURN / 60),
    Unit("arcsec", 2 * _PI, _ARCSEC_PER_TURN),
)
_TIMES = (Unit("s"), Unit("ms", over=_KILO), Unit("min", 60.0), Unit("h", 3600.0))
_EXPANSIONS = (Unit("1/K"), Unit("ppm/K", over=_MILLION), Unit("um/m/K", over=_MILLION))
_SPEEDS = (
    Unit("mm/s"),
    Unit("mm/min", over=60.0),
    Unit("um/s", over=_KILO),
    Unit("um/min", over=60.0 * _KILO),
    Unit("um/h", over=3600.0 * _KILO),
    Unit("m/s", _KILO),
    Unit("m/min", _KILO, 60.0),
)
_RATES = (
    Unit("1/s"),
    Unit("1/min", over=60.0),
    Unit("1/h", over=3600.0),
    Unit("ppm/min", over=60.0 * _MILLION),
    Unit("ppm/h", over=3600.0 * _MILLION),
)
_CURVATURES = (Unit("1/mm"), Unit("1/m", over=_KILO))
_IMAGE_SPEEDS = (Unit("px/s"), Unit("px/min", over=60.0), Unit("px/h", over=3600.0))


def _scaled(symbol: str, **prefixes: float) -> tuple[Unit, ...]:
    """Return a unit and its prefixed forms, given how many of each make one."""
    return (Unit(symbol), *(Unit(prefix + symbol, over=over) for prefix, over in prefixes.items()))


def _si(symbol: str) -> tuple[Unit, ...]:
    """Return a unit with the prefixes of the SI from pico to giga."""
    larger = (Unit(prefix + symbol, times) for prefix, times in (("k", _KILO), ("M", _MILLION), ("G", _BILLION)))
    return (*_scaled(symbol, m=_KILO, u=_MILLION, n=_BILLION, p=_KILO * _BILLION), *larger)


_MASSES = (Unit("kg"), *(Unit(unit.symbol, unit.times, unit.over * _KILO) for unit in _si("g") if unit.symbol != "kg"))
_PRESSURES = (
    Unit("hPa"),
    *(Unit(unit.symbol, unit.times, unit.over * 100.0) for unit in _si("Pa")),
    Unit("mbar"),
    Unit("bar", _KILO),
)

_ALL = (
    Dimension("length", "a length", "0.1 mm", _LENGTHS, "mm"),
    Dimension("wavelength", "a wavelength", "633 nm", (Unit("mm"), *_LENGTHS[2:]), "mm"),
    Dimension("angle", "an angle", "20 arcsec", _ANGLES),
    Dimension("slope", "a slope", "0.1 mm/m", _SLOPES[1:]),
    Dimension("ratio", "a ratio of lengths", "0.1 um/m", (*_SLOPES[1:], *_SCALES)),
    Dimension("time", "a time", "2 s", _TIMES, "s"),
    Dimension("temperature", "a temperature", "20.5 degC", (Unit("degC"), Unit("K", offset=-_KELVIN_AT_0_DEGC)), "K"),
    Dimension("temperature difference", "a temperature difference", "0.5 K", _scaled("K", m=_KILO), "K"),
    Dimension("expansion", "a coefficient of expansion", "11.5e-6 1/K", _EXPANSIONS, "K-1"),
    Dimension("pressure", "a pressure", "1013.25 hPa", _PRESSURES, "kg mm-1 s-2", 0.1),
    Dimension("humidity", "a relative humidity", "50 percent", (Unit("percent"),), coherent=0.01),
    Dimension("pixel", "a distance in the image", "0.1 px", (Unit("px"),), "px"),
    Dimension("speed", "a speed", "0.5 um/min", _SPEEDS, "mm s-1"),
    Dimension("rate", "a change of a ratio with time", "1 ppm/h", _RATES, "s-1"),
    Dimension("curvature", "a curvature", "1e-6 1/mm", _CURVATURES, "mm-1"),
    Dimension("image speed", "a speed in the image", "0.1 px/h", _IMAGE_SPEEDS, "px s-1"),
    Dimension("mass", "a mass", "0.5 kg", _MASSES, "kg"),
    Dimension("voltage", "a voltage", "5 mV", _si("V"), "kg mm2 s-3 A-1", _MILLION),
    Dimension("current", "a current", "5 mA", _si("A"), "A"),
    Dimension("resistance", "a resistance", "100 ohm", _si("ohm"), "kg mm2 s-3 A-2", _MILLION),
    Dimension("conductance", "a conductance", "5 mS", _si("S"), "kg-1 mm-2 s3 A2", 1 / _MILLION),
    Dimension("capacitance", "a capacitance", "10 pF", _si("F"), "kg-1 mm-2 s4 A2", 1 / _MILLION),
    Dimension("inductance", "an inductance", "3 mH", _si("H"), "kg mm2 s-2 A-2", _MILLION),
    Dimension("magnetic flux density", "a magnetic flux density", "2 mT", _si("T"), "kg s-2 A-1"),
    Dimension("frequency", "a frequency", "50 Hz", _si("Hz"), "s-1"),
    Dimension("force", "a force", "10 N", _si("N"), "kg mm s-2", _KILO),
    Dimension("energy", "an energy", "5 J", _si("J"), "kg mm2 s-2", _MILLION),
    Dimension("power", "a power", "5 W", _si("W"), "kg mm2 s-3", _MILLION),
    Dimension("volume", "a volume", "20 ml", _scaled("l", m=_KILO, u=_MILLION), "mm3", _MILLION),
    Dimension("amount", "an amount of substance", "2 mol", _si("mol"), "mol"),
    Dimension("luminous intensity", "a luminous intensity", "3 cd", _si("cd"), "cd"),
)
DIMENSIONS = {dimension.name: dimension for dimension in _ALL}
"""The closed table, by name."""

_INTERNAL = {"slope": "1", "ratio": "1"}
_SPELLINGS = {"\u00b5": "u", "\u03bc": "u", "°C": "degC", "°": "deg", "%": "percent", "\u03a9": "ohm", "\u2126": "ohm"}
"""Both micro signs and both ohm signs of Unicode."""
_WORDS = {
    "micron": "um", "microns": "um", "micrometer": "um", "micrometre": "um", "millimeter": "mm", "millimetre": "mm",
    "meter": "m", "metre": "m", "degree": "deg", "degrees": "deg", "pixel": "px", "pixels": "px", "sec": "s",
    "second": "s", "seconds": "s", "minute": "min", "minutes": "min", "hour": "h", "as": "arcsec", "Mm": "mm",
    "MM": "mm", "C": "degC", "celsius": "degC", "in": "mm", "inch": "mm", "'": "arcmin", "''": "arcsec", '"': "arcsec",
}  # fmt: skip
_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_QUANTITY = re.compile(rf"({_NUMBER})\s*(.*)", re.DOTALL)
_COMMA = re.compile(r"([+-]?[0-9]*),([0-9]+)(.*)", re.DOTALL)


def internal_unit(dimension: str) -> str:
    """Return the unit that values of a dimension have inside the program ("1" for slopes and ratios)."""
    return _INTERNAL.get(dimension, DIMENSIONS[dimension].unit)


def parse_quantity(text: str, dimension: str) -> float:
    """Return a text such as "20 arcsec" in the internal unit of its dimension; QuantityError says what is wrong."""
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
        raise QuantityError(f"{text} has no unit", f"write e.g. '{match[1]} {_example_unit(wanted)}'")
    return find_unit(match[2], dimension, match[1]).inside(number)


def find_unit(symbol: str, dimension: str, number: str = "1") -> Unit:
    """Return the unit with this symbol (micro signs, degree signs and % as people type them), or QuantityError."""
    wanted = DIMENSIONS[dimension]
    plain = plain_symbol(symbol)
    for unit in wanted.units:
        if unit.symbol == plain:
            return unit
    accepted = f"allowed: {', '.join(wanted.symbols)}"
    if plain in ("degC", "K") and dimension.startswith("temperature"):
        raise QuantityError(f"'{symbol}' cannot be the unit of {wanted.phrase}", f"write '{number} {wanted.unit}'")
    others = [other.phrase for other in _ALL if plain in other.symbols]
    if others:
        raise QuantityError(f"'{symbol}' is the unit of {others[0]}, not of {wanted.phrase}", accepted)
    if not re.fullmatch(r"[^\W\d_]+(/[^\W\d_]+)*|1/[^\W\d_]+", plain):
        raise QuantityError(f"'{symbol}' after {number} is not one unit", f"write e.g. '{wanted.example}'")
    near = nearest(plain, wanted.symbols)
    raise QuantityError(f"unknown unit '{symbol}'", f"did you mean '{near}'? {accepted}" if near else accepted)


def plain_symbol(symbol: str) -> str:
    """Return a unit as the table spells it: "\u00b5m" is "um", "\u00b0C" is "degC", "%" is "percent"."""
    for typed, plain in _SPELLINGS.items():
        symbol = symbol.replace(typed, plain)
    return symbol.strip()


def nearest(word: str, known: tuple[str, ...]) -> str | None:
    """Return the unit that was probably meant."""
    from difflib import get_close_matches

    meant = _WORDS.get(word)
    if meant in known:
        return meant
    return next(iter(get_close_matches(word, known, 1, 0.5)), None)


def _example_unit(dimension: Dimension) -> str:
    return dimension.example.split(" ", 1)[1]


def quantity_pattern(dimension: str) -> str:
    """Return the regular expression (ECMA 262) of a quantity, for the schema of a job."""
    symbols = "|".join(sorted(_typed_forms(DIMENSIONS[dimension]), key=len, reverse=True))
    return rf"^\s*{_NUMBER}\s*({symbols})\s*$"


def _typed_forms(dimension: Dimension) -> set[str]:
    forms = set(dimension.symbols)
    for typed, plain in _SPELLINGS.items():
        forms |= {symbol.replace(plain, typed) for symbol in dimension.symbols if plain in symbol}
    return {form for form in forms if plain_symbol(form) in dimension.symbols}


def suffixes(dimension: str) -> dict[str, Unit]:
    """Return the endings of a CSV column that holds this dimension: {"mm": ..., "um_per_m": ...}."""
    return {_suffix(unit.symbol): unit for unit in DIMENSIONS[dimension].units}


def _suffix(symbol: str) -> str:
    return symbol.replace("1/", "per_").replace("/", "_per_")


def suffix_of(unit: str) -> str:
    """Return the ending of a CSV column with this internal unit, "" for a plain number."""
    return "" if unit in ("", "1") else _suffix(unit)


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
    return angle * _KILO, "mm/m"
