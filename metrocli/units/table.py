"""The closed table of units.

Internal units: millimetre, radian, second, pixel, degree Celsius, kelvin for differences, hectopascal, percent of
relative humidity, 1 for ratios and slopes. A unit that is not in the table is refused, never reinterpreted.
"""

from __future__ import annotations

import math

from metrocli.arrays import Array
from metrocli.frozen import dataclass

_PI = math.pi
_ARCSEC_PER_TURN = 1_296_000.0
_KELVIN_AT_0_DEGC = 273.15
INCH = 25.4
"""Millimetres per inch. Files cannot use inches; the factor detects data that are in inches by mistake"""


@dataclass(frozen=True)
class Unit:
    """One unit of one dimension: internal value = number * times / over + offset."""

    symbol: str
    times: float = 1.0
    over: float = 1.0
    offset: float = 0.0
    reported: bool = True
    """Whether reports choose it; files may use any"""

    def inside(self, number: float) -> float:
        """Return the internal value of a number in this unit, rounded only once if the factor is a power of ten."""
        return number * self.times / self.over + self.offset

    def outside(self, value: float) -> float:
        """Return an internal value as a number in this unit."""
        return (value - self.offset) * self.over / self.times

    def array_inside(self, numbers: Array) -> Array:
        """Return a column of numbers in this unit as internal values; the same array if the unit is internal."""
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
    """Powers of the base units mm, s, kg, A, K, px, mol, cd, such as "mm s-1"; empty for a plain number."""
    coherent: float = 1.0
    """Value of the internal unit in these base units."""

    @property
    def unit(self) -> str:
        """The internal unit."""
        return self.units[0].symbol

    @property
    def symbols(self) -> tuple[str, ...]:
        """The symbols of the units that a file may use."""
        return tuple(unit.symbol for unit in self.units)


class QuantityError(ValueError):
    """A text is not a quantity of the wanted dimension; `hint` proposes what to write."""

    def __init__(self, message: str, hint: str) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


KILO, _MILLION, _BILLION = 1e3, 1e6, 1e9
_LENGTHS = (
    Unit("mm"),
    Unit("m", KILO),
    Unit("um", over=KILO),
    Unit("nm", over=_MILLION),
    Unit("cm", 10.0, reported=False),
    Unit("dm", 100.0, reported=False),
    Unit("km", _MILLION, reported=False),
    Unit("ft", 12 * INCH, reported=False),
)
_SLOPES = (Unit("1"), Unit("mm/m", over=KILO), Unit("um/m", over=_MILLION), Unit("nm/m", over=_BILLION))
_SCALES = (Unit("percent", over=100.0), Unit("ppm", over=_MILLION), Unit("ppb", over=_BILLION))
_ANGLES = (
    Unit("rad"),
    Unit("mrad", over=KILO),
    Unit("urad", over=_MILLION),
    Unit("deg", _PI, 180.0),
    Unit("mdeg", _PI, 180.0 * KILO, reported=False),
    Unit("arcmin", 2 * _PI, _ARCSEC_PER_TURN / 60),
    Unit("arcsec", 2 * _PI, _ARCSEC_PER_TURN),
    Unit("gon", _PI, 200.0, reported=False),
    Unit("mgon", _PI, 200.0 * KILO, reported=False),
)
_TIMES = (Unit("s"), Unit("ms", over=KILO), Unit("min", 60.0), Unit("h", 3600.0))
_EXPANSIONS = (Unit("1/K"), Unit("ppm/K", over=_MILLION), Unit("um/m/K", over=_MILLION))
_SPEEDS = (
    Unit("mm/s"),
    Unit("mm/min", over=60.0),
    Unit("um/s", over=KILO),
    Unit("um/min", over=60.0 * KILO),
    Unit("um/h", over=3600.0 * KILO),
    Unit("m/s", KILO),
    Unit("m/min", KILO, 60.0),
)
_ANGLE_RATES = (
    Unit("rad/s"),
    Unit("arcsec/min", 2 * _PI, 60.0 * _ARCSEC_PER_TURN),
    Unit("arcsec/h", 2 * _PI, 3600.0 * _ARCSEC_PER_TURN),
    Unit("urad/min", over=60.0 * _MILLION),
    Unit("urad/h", over=3600.0 * _MILLION),
)
_RATES = (
    Unit("1/s"),
    Unit("1/min", over=60.0),
    Unit("1/h", over=3600.0),
    Unit("ppm/min", over=60.0 * _MILLION),
    Unit("ppm/h", over=3600.0 * _MILLION),
)
_CURVATURES = (Unit("1/mm"), Unit("1/m", over=KILO))
_IMAGE_SPEEDS = (Unit("px/s"), Unit("px/min", over=60.0), Unit("px/h", over=3600.0))


def _scaled(symbol: str, **prefixes: float) -> tuple[Unit, ...]:
    """Return a unit and its smaller prefixed units, given how many of each make one unit."""
    return (Unit(symbol), *(Unit(prefix + symbol, over=over) for prefix, over in prefixes.items()))


def _si(symbol: str) -> tuple[Unit, ...]:
    """Return a unit with the prefixes of the SI from pico to giga."""
    larger = (Unit(prefix + symbol, times) for prefix, times in (("k", KILO), ("M", _MILLION), ("G", _BILLION)))
    return (*_scaled(symbol, m=KILO, u=_MILLION, n=_BILLION, p=KILO * _BILLION), *larger)


_MASSES = (Unit("kg"), *(Unit(unit.symbol, unit.times, unit.over * KILO) for unit in _si("g") if unit.symbol != "kg"))
_PRESSURES = (
    Unit("hPa"),
    *(Unit(unit.symbol, unit.times, unit.over * 100.0) for unit in _si("Pa")),
    Unit("mbar"),
    Unit("bar", KILO),
    Unit("psi", 68.94757293168361, reported=False),
)

_ALL = (
    Dimension("length", "a length", "0.1 mm", _LENGTHS, "mm"),
    Dimension("wavelength", "a wavelength", "633 nm", (Unit("mm"), *_LENGTHS[2:4]), "mm"),
    Dimension("radius", "a radius of curvature", "6371 km", _LENGTHS, "mm"),
    Dimension("angle", "an angle", "20 arcsec", _ANGLES),
    Dimension("slope", "a slope", "0.1 mm/m", _SLOPES[1:]),
    Dimension("ratio", "a ratio of lengths", "0.1 um/m", (*_SLOPES[1:], *_SCALES)),
    Dimension("time", "a time", "2 s", _TIMES, "s"),
    Dimension("temperature", "a temperature", "20.5 degC", (Unit("degC"), Unit("K", offset=-_KELVIN_AT_0_DEGC)), "K"),
    Dimension("temperature difference", "a temperature difference", "0.5 K", _scaled("K", m=KILO), "K"),
    Dimension("expansion", "a coefficient of expansion", "11.5e-6 1/K", _EXPANSIONS, "K-1"),
    Dimension("pressure", "a pressure", "1013.25 hPa", _PRESSURES, "kg mm-1 s-2", 0.1),
    Dimension("humidity", "a relative humidity", "50 percent", (Unit("percent"),), coherent=0.01),
    Dimension("pixel", "a distance in the image", "0.1 px", (Unit("px"),), "px"),
    Dimension("speed", "a speed", "0.5 um/min", _SPEEDS, "mm s-1"),
    Dimension("angle rate", "a change of an angle with time", "1 arcsec/h", _ANGLE_RATES, "s-1"),
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
    Dimension("force", "a force", "10 N", _si("N"), "kg mm s-2", KILO),
    Dimension("energy", "an energy", "5 J", _si("J"), "kg mm2 s-2", _MILLION),
    Dimension("power", "a power", "5 W", _si("W"), "kg mm2 s-3", _MILLION),
    Dimension("volume", "a volume", "20 ml", _scaled("l", m=KILO, u=_MILLION), "mm3", _MILLION),
    Dimension("amount", "an amount of substance", "2 mol", _si("mol"), "mol"),
    Dimension("luminous intensity", "a luminous intensity", "3 cd", _si("cd"), "cd"),
)
DIMENSIONS = {dimension.name: dimension for dimension in _ALL}
"""All dimensions by name."""
