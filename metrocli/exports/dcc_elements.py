"""Elements of a Digital Calibration Certificate that several of its parts have, and its text."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree as ET

from metrocli.exports import dsi
from metrocli.record import Record

DCC, XSI = "https://ptb.de/dcc", "http://www.w3.org/2001/XMLSchema-instance"
_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def add(to: ET.Element, name: str, text: Any = None) -> ET.Element:
    """Return a new element of the certificate, with a text if given."""
    made = ET.SubElement(to, f"{{{DCC}}}{name}")
    if text is not None:
        made.text = _NO_XML.sub("\N{REPLACEMENT CHARACTER}", str(text))
    return made


def named(to: ET.Element, name: str, *texts: str) -> None:
    """Add an element that holds texts in English."""
    made = add(to, name)
    for text in texts:
        add(made, "content", text).set("lang", "en")


def identified(to: ET.Element, numbers: Sequence[tuple[str, str | None, str]]) -> None:
    """Add numbers that identify something, each with its issuer and what it is; none if there are none."""
    given = [one for one in numbers if one[1]]
    held = add(to, "identifications") if given else to
    for issuer, value, name in given:
        one = add(held, "identification")
        add(one, "issuer", issuer)
        add(one, "value", value)
        named(one, "name", name)


def software_of(to: ET.Element, name: str, record: Record) -> None:
    """Add the program; PTB's Schematron rules want one letter before the numbers of its release."""
    software = add(add(to, name), "software")
    named(software, "name", "metrocli")
    add(software, "release", f"v{record.metrocli_version}")
    add(software, "type", "application")


def text_of(root: ET.Element) -> str:
    """Return a certificate as text."""
    for prefix, space in (("dcc", DCC), ("si", dsi.SI), ("xsi", XSI)):
        ET.register_namespace(prefix, space)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
