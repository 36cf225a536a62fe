"""The key `certificate:` of a job: what a calibration certificate states beside the result."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict
from datetime import date
from itertools import pairwise
from typing import Any

from metrocli.errors import Fault
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings.composites import MapOf
from metrocli.settings.sections import Section, setting
from metrocli.settings.values import Choice, OfText, Schema, refuse

PLACES = ("laboratory", "customer", "laboratoryBranch", "customerBranch", "other")
"""Where a calibration is performed, in the words of the DCC"""


class _TextLine(OfText):
    """A text of one line; blanks at its ends do not count."""

    expects = "a text of one line"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        text = node.text.strip() if self.fits(node) else ""
        return text if text and text.isprintable() else refuse(self, node, faults)

    def schema(self) -> Schema:
        return {"type": ["string", "number"]}


class _Country(OfText):
    """The code of a country by ISO 3166-1."""

    expects = "two capital letters (ISO 3166-1), such as DE"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        known = self.fits(node) and re.fullmatch("[A-Z]{2}", node.text)
        return node.text if known else refuse(self, node, faults)

    def schema(self) -> Schema:
        return {"type": "string", "pattern": "^[A-Z]{2}$"}


class _Date(OfText):
    """A day."""

    expects = "a date such as 2026-11-20"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        try:
            if self.fits(node) and re.fullmatch("[0-9]{4}-[0-9]{2}-[0-9]{2}", node.text):
                return date.fromisoformat(node.text).isoformat()
        except ValueError:
            pass  # a day that no month has
        return refuse(self, node, faults)

    def schema(self) -> Schema:
        return {"type": "string", "format": "date"}


@dataclass(frozen=True)
class Party:
    """A laboratory or a customer."""

    name: str = setting(_TextLine(), "name", default="")
    street: str = setting(_TextLine(), "street and number", default="")
    post_code: str = setting(_TextLine(), "post code", default="")
    city: str = setting(_TextLine(), "city", default="")
    country: str = setting(_Country(), "country", default="")
    email: str = setting(_TextLine(), "address for mail", default="")
    code: str = setting(_TextLine(), "code of an accredited laboratory", default="")


@dataclass(frozen=True)
class Item:
    """The item that is calibrated."""

    name: str = setting(_TextLine(), "what it is", default="")
    manufacturer: str = setting(_TextLine(), "manufacturer", default="")
    model: str = setting(_TextLine(), "model", default="")
    serial: str = setting(_TextLine(), "serial number", default="")
    inventory: str = setting(_TextLine(), "number that its owner gives it", default="")


@dataclass(frozen=True)
class Certificate:
    """What a calibration certificate states beside the result; the export lists what is missing."""

    number: str = setting(_TextLine(), "number of the certificate", default="")
    order: str = setting(_TextLine(), "number of the order", default="")
    laboratory: Party = setting(Section(Party), "the laboratory that calibrates", default=Party())
    customer: Party = setting(Section(Party), "who ordered the calibration", default=Party())
    item: Item = setting(Section(Item), "the item that is calibrated", default=Item())
    person: str = setting(_TextLine(), "the person who is responsible", default="")
    received: str = setting(_Date(), "day on which the item arrived", default="")
    begin: str = setting(_Date(), "first day of the measurement", default="")
    end: str = setting(_Date(), "last day of the measurement", default="")
    issued: str = setting(_Date(), "day of issue", default="")
    place: str = setting(Choice(*PLACES), "where the item was measured", default="laboratory")
    references: Mapping[str, str] = setting(
        MapOf(_TextLine()),
        "certificate number of each reference: an input as the job names it, or a standard",
        default={},
    )

    def faults(self) -> Any:
        """Yield a fault for each pair of days in the wrong order."""
        days = [(name, getattr(self, name)) for name in ("received", "begin", "end", "issued")]
        days = [(name, day) for name, day in days if day]
        for (before, first), (after, second) in pairwise(days):
            if second < first:
                yield after, f"{after}: {second} is before {before}: {first}", "correct one of the dates"

    def stated(self) -> dict[str, Any]:
        """Return the keys that are given, with texts or mappings of texts."""
        return _given(asdict(self))


def _given(values: Mapping[str, Any]) -> dict[str, Any]:
    below = ((name, _given(entry) if isinstance(entry, Mapping) else entry) for name, entry in values.items())
    return {name: entry for name, entry in below if entry}
