"""Single values of a job file: specifications that read a node, collect its faults, and describe themselves.

Values are read from the text as it stands in the file, never from a type that YAML made of it: `1e-6` is a number,
`012345` a serial number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from metrocli import units
from metrocli.errors import Fault
from metrocli.nodes import Node
from metrocli.words import suggestion

Schema = dict[str, Any]


class _Bad:
    """The value of something with a fault; it never reaches a task."""

    def __repr__(self) -> str:
        return "BAD"


BAD = _Bad()


class Spec(Protocol):
    """How one value is read and described."""

    @property
    def expects(self) -> str:
        """What may stand here, in words: "a length such as 0.1 mm"."""

    def fits(self, node: Node) -> bool:
        """Tell whether the node has the shape of this value, so that its faults are worth telling."""

    def read(self, node: Node, faults: list[Fault]) -> Any:
        """Return the value, or add to `faults` and return BAD."""

    def schema(self) -> Schema:
        """Return the JSON schema (2020-12) of the value."""


def refuse(spec: Spec, node: Node, faults: list[Fault], reason: str = "", hint: str | None = None) -> Any:
    found = reason or described(node)
    faults.append(node.fault(f"{node.path}: {found}", hint or f"expected {spec.expects}"))
    return BAD


def described(node: Node) -> str:
    if node.empty:
        return "there is no value"
    return f"'{node.text}' is not expected here" if node.kind == "scalar" else f"a {node.kind} is not expected here"


class OfText:
    """What all values written as one word, number or text have in common."""

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar" and not node.empty


@dataclass(frozen=True)
class Text(OfText):
    """Any text, as it stands in the file."""

    expects = "text"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        return node.text if self.fits(node) else refuse(self, node, faults)

    def schema(self) -> Schema:
        return {"type": ["string", "number", "boolean"]}


@dataclass(frozen=True)
class Flag(OfText):
    """true or false."""

    expects = "true or false"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        words = {"true": True, "false": False}
        return words[node.text] if self.fits(node) and node.text in words else refuse(self, node, faults)

    def schema(self) -> Schema:
        return {"type": "boolean"}


class Choice(OfText):
    """One of a few words."""

    def __init__(self, *words: str) -> None:
        self.words = words

    @property
    def expects(self) -> str:
        return self.words[0] if len(self.words) == 1 else f"one of: {', '.join(self.words)}"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return refuse(self, node, faults)
        if node.text in self.words:
            return node.text
        return refuse(self, node, faults, f"unknown word '{node.text}'", suggestion(node.text, self.words))

    def schema(self) -> Schema:
        return {"enum": list(self.words)}


_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+")
_WHOLE = re.compile(r"[+-]?[0-9]{1,15}")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class Number(OfText):
    """A plain number without a unit, within limits that belong to it (`above`: not itself)."""

    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None

    @property
    def expects(self) -> str:
        limits = (("above", self.above), ("at least", self.minimum), ("at most", self.maximum))
        return f"a number{_limits(limits)}"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return refuse(self, node, faults)
        if _COMMA.fullmatch(node.text):
            return refuse(self, node, faults, "has a decimal comma", f"write {node.text.replace(',', '.')}")
        if not _NUMBER.fullmatch(node.text) or not math.isfinite(float(node.text)):
            return refuse(self, node, faults, f"'{node.text}' is not a plain number")
        return self.within(node, float(node.text), faults)

    def within(self, node: Node, value: float, faults: list[Fault]) -> Any:
        """Return the value, BAD with a fault where it is outside the limits."""
        low = (self.minimum is not None and value < self.minimum) or (self.above is not None and value <= self.above)
        if low or (self.maximum is not None and value > self.maximum):
            return refuse(self, node, faults, f"{node.text} is out of range")
        return value

    def schema(self) -> Schema:
        limits = {"minimum": self.minimum, "maximum": self.maximum, "exclusiveMinimum": self.above}
        return {"type": "number"} | {key: value for key, value in limits.items() if value is not None}


@dataclass(frozen=True)
class Whole(OfText):
    """A whole number, within limits that belong to it."""

    minimum: int | None = None
    maximum: int | None = None

    @property
    def expects(self) -> str:
        return f"a whole number{_limits((('at least', self.minimum), ('at most', self.maximum)))}"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node) or not _WHOLE.fullmatch(node.text):
            return refuse(self, node, faults)
        limits = Number(self.minimum, self.maximum).within(node, int(node.text), [])
        return refuse(self, node, faults, f"{node.text} is out of range") if limits is BAD else int(node.text)

    def schema(self) -> Schema:
        limits = {"minimum": self.minimum, "maximum": self.maximum}
        return {"type": "integer"} | {key: value for key, value in limits.items() if value is not None}


def _limits(limits: Iterable[tuple[str, float | None]]) -> str:
    words = [f"{word} {limit:g}" for word, limit in limits if limit is not None]
    return f" of {' and '.join(words)}" if words else ""


@dataclass(frozen=True)
class Quantity(OfText):
    """A number with its unit in one text, read as a float in the internal unit of its dimension."""

    dimension: str
    positive: bool = False
    """Refuse zero and below."""
    minimum: float | None = None
    """In the internal unit."""

    @property
    def expects(self) -> str:
        dimension = units.DIMENSIONS[self.dimension]
        return f"{dimension.phrase} such as '{dimension.example}'"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return refuse(self, node, faults)
        try:
            value = units.parse_quantity(node.text, self.dimension)
        except units.QuantityError as error:
            return refuse(self, node, faults, error.message, error.hint)
        if self.positive and value <= 0:
            return refuse(self, node, faults, f"{node.text} is not above zero")
        if self.minimum is not None and value < self.minimum:
            return refuse(self, node, faults, f"{node.text} is too small")
        return value

    def schema(self) -> Schema:
        return {"type": "string", "pattern": units.quantity_pattern(self.dimension)}
