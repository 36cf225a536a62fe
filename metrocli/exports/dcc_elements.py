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


def add(to: ET.Element, name: str, text: Any = None, **attributes: str) -> ET.Element:
    """Return a new element of the certificate, with a text and attributes if given."""
    made = ET.SubElement(to, f"{{{DCC}}}{name}", attributes)
    if text is not None:
        made.text = _NO_XML.sub("\N{REPLACEMENT CHARACTER}", str(text))
    return made


def named(to: ET.Element, name: str, text: str) -> None:
    """Add an element that holds a text in English, one content only: PTB's rules want one for each language."""
    add(add(to, name), "content", text, lang="en")


def called(to: ET.Element, name: str) -> None:
    """Add the name of a person, a firm or a thing as the job states it, in no language."""
    add(add(to, "name"), "content", name)


def identified(to: ET.Element, numbers: Sequence[tuple[str, str | None, str]]) -> None:
    """Add numbers that identify something, each with its issuer and what it is; none if there are none.

    What it is stands there twice, for people and as a refType of DKD: "serial number" is `basic_serialNumber`.
    """
    given = [one for one in numbers if one[1]]
    held = add(to, "identifications") if given else to
    for issuer, value, name in given:
        first, *others = name.split()
        one = add(held, "identification", refType=f"basic_{first}{''.join(map(str.capitalize, others))}")
        add(one, "issuer", issuer)
        add(one, "value", value)
        named(one, "name", name)


def software_of(to: ET.Element, name: str, record: Record) -> None:
    """Add the program; PTB's Schematron rules want one letter before the numbers of its release."""
    software = add(add(to, name), "software")
    called(software, "metrocli")
    add(software, "release", f"v{record.metrocli_version}")
    add(software, "type", "application")


def text_of(root: ET.Element) -> str:
    """Return a certificate as text."""
    for prefix, space in (("dcc", DCC), ("si", dsi.SI), ("xsi", XSI)):
        ET.register_namespace(prefix, space)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
