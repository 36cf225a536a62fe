"""Quantities in the notation of the D-SI model: units such as \\milli\\metre, values with expanded uncertainty.

Source: D-SI (SmartCom, EMPIR 17IND02), https://ptb.de/si, with the elements of version 2.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import numpy.typing as npt

from metrocli import units
from metrocli.errors import Fault

SI = "https://ptb.de/si"
PIXEL = "px"
"""The unit of images, which the SI does not have: its quantities are stated in \\one, with a remark"""
_UNITS = {
    "m": "metre", "g": "gram", "s": "second", "K": "kelvin", "A": "ampere", "mol": "mole", "cd": "candela",
    "rad": "radian", "Pa": "pascal", "l": "litre", "V": "volt", "F": "farad", "S": "siemens", "T": "tesla",
    "H": "henry", "Hz": "hertz", "N": "newton", "J": "joule", "W": "watt", "ohm": "ohm",
}  # fmt: skip
_WHOLE = {
    "kg": "kilogram", "min": "minute", "h": "hour", "deg": "degree", "arcmin": "arcminute", "arcsec": "arcsecond",
    "degC": "degreecelsius", "percent": "percent", "ppm": "ppm",
}  # fmt: skip
"""Units that have no prefix"""
_PREFIXES = {"p": "pico", "n": "nano", "u": "micro", "m": "milli", "h": "hecto", "k": "kilo", "M": "mega", "G": "giga"}
_FACTOR = re.compile(r"([A-Za-z]+)\^?(-?[0-9]+)?")
_MOST_DIGITS = 15


def unit_of(symbol: str) -> str | None:
    """Return a unit such as "um/m" in D-SI notation, \\micro\\metre\\metre\\tothe{-1}; None for one that D-SI lacks."""
    above, *below = symbol.split("/")
    found = [_factor(one, 1) for one in above.split()] + [_factor(one, -1) for part in below for one in part.split()]
    return None if None in found else "".join(map(str, found)) or "\\one"


def _factor(text: str, sign: int) -> str | None:
    if text in ("1", PIXEL):
        return ""
    match = _FACTOR.fullmatch(text)
    if match is None:
        return None
    symbol, power = match[1], sign * int(match[2] or 1)
    if symbol in _WHOLE:
        name = f"\\{_WHOLE[symbol]}"
    elif symbol in _UNITS:
        name = f"\\{_UNITS[symbol]}"
    elif symbol[0] in _PREFIXES and symbol[1:] in _UNITS:
        name = f"\\{_PREFIXES[symbol[0]]}\\{_UNITS[symbol[1:]]}"
    else:
        return None
    return name if power == 1 else f"{name}\\tothe{{{power}}}"


def without_notation(symbols: Sequence[str]) -> list[Fault]:
    """Return a fault for each unit that D-SI has no notation for."""
    unknown = sorted({one for one in symbols if unit_of(one) is None})
    hint = "state the quantity in another unit of the same dimension"
    return [Fault(f"the unit {one} has no notation in D-SI", hint=hint) for one in unknown]


def real(to: Element, value: float, unit: str, spread: float, k: float, probability: float) -> None:
    """Add a value with its expanded uncertainty `spread`, both rounded to two digits of it; none if it is zero."""
    number, uncertainty = units.rounded(value, spread)
    made = SubElement(to, f"{{{SI}}}real")
    _texts(made, {"value": number, "unit": str(unit_of(unit))})
    if spread > 0:
        held = _nested(made, "measurementUncertaintyUnivariate", "expandedMU")
        coverage = {"coverageFactor": f"{k:.4g}", "coverageProbability": f"{probability:.4g}"}
        _texts(held, {"valueExpandedMU": uncertainty, **coverage})


def real_list(
    to: Element,
    values: npt.NDArray[np.float64],
    unit: str,
    spreads: npt.NDArray[np.float64] | None,
    k: float,
    probability: float,
) -> None:
    """Add values with their expanded uncertainties, (n,) each, rounded to two digits of the smallest one.

    Values without uncertainties, such as places, have ten digits.
    """
    made = SubElement(to, f"{{{SI}}}realListXMLList")
    if spreads is None:
        _texts(made, {"valueXMLList": " ".join(np.char.mod("%.10g", values)), "unitXMLList": str(unit_of(unit))})
        return
    smallest = np.min(spreads[spreads > 0], initial=np.inf)
    digits = 1 - int(np.floor(np.log10(smallest))) if np.isfinite(smallest) else _MOST_DIGITS
    form = f"%.{min(max(digits, 0), _MOST_DIGITS)}f"
    _texts(made, {"valueXMLList": " ".join(np.char.mod(form, values)), "unitXMLList": str(unit_of(unit))})
    held = _nested(made, "measurementUncertaintyUnivariateXMLList", "expandedMUXMLList")
    coverage = {"coverageFactorXMLList": f"{k:.4g}", "coverageProbabilityXMLList": f"{probability:.4g}"}
    _texts(held, {"valueExpandedMUXMLList": " ".join(np.char.mod(form, spreads)), **coverage})


def _nested(to: Element, *names: str) -> Element:
    for name in names:
        to = SubElement(to, f"{{{SI}}}{name}")
    return to


def _texts(to: Element, texts: dict[str, str]) -> None:
    for name, text in texts.items():
        SubElement(to, f"{{{SI}}}{name}").text = text
