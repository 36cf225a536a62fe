"""Elements of a digital calibration certificate, and numbers with units in D-SI."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from metrocli import units
from metrocli.arrays import Array
from metrocli.errors import Fault
from metrocli.record import Record

DCC, XSI = "https://ptb.de/dcc", "http://www.w3.org/2001/XMLSchema-instance"
_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def add(to: ET.Element, name: str, text: Any = None, **attributes: str) -> ET.Element:
    """Return a new element of the certificate, with a text and attributes if given."""
    made = ET.SubElement(to, f"{{{DCC}}}{name}", attributes)
    if text is not None:
        made.text = _NO_XML.sub("\N{REPLACEMENT CHARACTER}", str(text))
    return made


def add_text(to: ET.Element, name: str, text: str) -> None:
    """Add an element that holds a text in English, one content only: PTB's rules want one for each language."""
    add(add(to, name), "content", text, lang="en")


def add_name(to: ET.Element, name: str) -> None:
    """Add the name of a person, a firm or a thing as the job states it, in no language."""
    add(add(to, "name"), "content", name)


def add_identifications(to: ET.Element, numbers: Sequence[tuple[str, str | None, str]]) -> None:
    """Add numbers that identify something, each with its issuer and what it is; none if there are none.

    What it is stands there twice, for people and as a refType of DKD: "serial number" is `basic_serialNumber`.
    """
    given = [number for number in numbers if number[1]]
    held = add(to, "identifications") if given else to
    for issuer, value, name in given:
        first, *others = name.split()
        element = add(held, "identification", refType=f"basic_{first}{''.join(map(str.capitalize, others))}")
        add(element, "issuer", issuer)
        add(element, "value", value)
        add_text(element, "name", name)


def add_software(to: ET.Element, name: str, record: Record) -> None:
    """Add the program; PTB's Schematron rules want one letter before the numbers of its release."""
    software = add(add(to, name), "software")
    add_name(software, "metrocli")
    add(software, "release", f"v{record.metrocli_version}")
    add(software, "type", "application")


def text_of(root: ET.Element) -> str:
    """Return a certificate as text."""
    for prefix, space in (("dcc", DCC), ("si", SI), ("xsi", XSI)):
        ET.register_namespace(prefix, space)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


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
_PLAIN, _MOST_DIGITS = ".10g", 15


def unit_of(symbol: str) -> str | None:
    """Return a unit such as "um/m" in D-SI notation, \\micro\\metre\\metre\\tothe{-1}; None for one that D-SI lacks."""
    above, *below = symbol.split("/")
    factors = [_factor(name, 1) for name in above.split()] + [
        _factor(name, -1) for part in below for name in part.split()
    ]
    return None if None in factors else "".join(map(str, factors)) or "\\one"


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
    unknown = sorted({symbol for symbol in symbols if unit_of(symbol) is None})
    hint = "state the quantity in another unit of the same dimension"
    return [Fault(f"the unit {name} has no notation in D-SI", hint=hint) for name in unknown]


def add_real(
    to: Element, value: float, unit: str, spread: float = 0.0, k: float = 2.0, probability: float = 1.0
) -> None:
    """Add a value with its expanded uncertainty `spread`, both rounded to two digits of it; none if it is zero.

    D-SI has no coverage factor below 1: there the standard uncertainty is stated.
    """
    shown = spread if k >= 1 else spread / k
    number, uncertainty = units.rounded(value, shown)
    made = SubElement(to, f"{{{SI}}}real")
    _texts(made, {"value": number, "unit": str(unit_of(unit))})
    if shown <= 0:
        return
    held = SubElement(made, f"{{{SI}}}measurementUncertaintyUnivariate")
    if k < 1:
        _texts(_nested(held, "standardMU"), {"valueStandardMU": uncertainty})
        return
    coverage = {"coverageFactor": _factor_text(k), "coverageProbability": _probability_text(probability)}
    _texts(_nested(held, "expandedMU"), {"valueExpandedMU": uncertainty, **coverage})


def _factor_text(k: float) -> str:
    """Return a coverage factor with four digits; D-SI allows it no exponent."""
    return np.format_float_positional(k, 4, unique=False, fractional=False, trim="-")


def _probability_text(probability: float) -> str:
    """Return a probability without exponent, with two digits at least of it and of what it leaves."""
    left = min(probability, 1 - probability)
    places = max(4, 1 - math.floor(math.log10(left))) if left > 0 else 0
    return f"{probability:.{places}f}".rstrip("0").rstrip(".") if places else f"{probability:.0f}"


def add_real_list(
    to: Element, values: Array, unit: str, spreads: Array | None = None, k: float = 2.0, probability: float = 1.0
) -> None:
    """Add values with their expanded uncertainties, (n,) each, rounded to two digits of the smallest one.

    Values without uncertainties, such as places and correlation coefficients, have ten digits.
    """
    made = SubElement(to, f"{{{SI}}}realListXMLList")
    form = _PLAIN if spreads is None else _form(values, spreads)
    _texts(made, {"valueXMLList": _numbers(values, form), "unitXMLList": str(unit_of(unit))})
    if spreads is None:
        return
    held = _nested(made, "measurementUncertaintyUnivariateXMLList", "expandedMUXMLList")
    coverage = {"coverageFactorXMLList": _factor_text(k), "coverageProbabilityXMLList": _probability_text(probability)}
    _texts(held, {"valueExpandedMUXMLList": _numbers(spreads, form), **coverage})


def _numbers(values: Array, form: str) -> str:
    return " ".join(format(number, form) for number in values.tolist())


def _form(values: Array, spreads: Array) -> str:
    """Return the form of numbers that shows two digits of the smallest uncertainty that is not zero."""
    positive = spreads[spreads > 0]
    if not len(positive):
        return _PLAIN
    digits = 1 - math.floor(math.log10(positive.min()))
    if digits <= _MOST_DIGITS:
        return f"z.{max(digits, 0)}f"
    largest = max(np.abs(values).max(), positive.max())
    return f".{min(math.floor(math.log10(largest)) + digits, _MOST_DIGITS)}e"


def _nested(to: Element, *names: str) -> Element:
    for name in names:
        to = SubElement(to, f"{{{SI}}}{name}")
    return to


def _texts(to: Element, texts: dict[str, str]) -> None:
    for name, text in texts.items():
        SubElement(to, f"{{{SI}}}{name}").text = text
