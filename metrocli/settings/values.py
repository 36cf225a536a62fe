"""Specifications of single values of a job file: they read a node, collect its faults, and describe themselves.

Values are read from the text in the file, never from the type that YAML assigns: `1e-6` is a number, `012345` a serial
number.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, Protocol

from metrocli import units
from metrocli.errors import Fault
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.words import composed, suggestion

Schema = dict[str, Any]


class _Bad:
    """Placeholder for a value with a fault; a job that contains it is refused, so no task receives it."""

    def __repr__(self) -> str:
        return "BAD"


BAD = _Bad()


class Spec(Protocol):
    """Interface of the specification of a value: how it is read and described."""

    @property
    def expects(self) -> str:
        """The expected value in words, for messages: "a length such as 0.1 mm"."""

    def fits(self, node: Node) -> bool:
        """Return whether the node has the form of this value (scalar, list, mapping); then its faults are reported."""

    def read(self, node: Node, faults: list[Fault]) -> Any:
        """Return the value, or add to `faults` and return BAD."""

    def schema(self) -> Schema:
        """Return the JSON schema (2020-12) of the value."""


def refuse(spec: Spec, node: Node, faults: list[Fault], reason: str = "", hint: str | None = None) -> Any:
    text = reason or described(node)
    faults.append(node.fault(f"{node.path}: {text}", hint or f"expected {spec.expects}"))
    return BAD


def described(node: Node) -> str:
    if node.empty:
        return "there is no value"
    return f"'{node.text}' is not expected here" if node.kind == "scalar" else f"a {node.kind} is not expected here"


class OfText:
    """Base of all values that are written as one word, number or text."""

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar" and not node.empty


@dataclass(frozen=True)
class Text(OfText):
    """Any text as in the file, with composed accents."""

    expects = "text"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        return composed(node.text) if self.fits(node) else refuse(self, node, faults)

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
    """One of a few words; `also` are other spellings of some of them."""

    def __init__(self, *words: str, also: Mapping[str, str] = MappingProxyType({})) -> None:
        self.words, self.also = words, also

    @property
    def expects(self) -> str:
        return self.words[0] if len(self.words) == 1 else f"one of: {', '.join(self.words)}"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return refuse(self, node, faults)
        if (word := self.also.get(node.text, node.text)) in self.words:
            return word
        return refuse(self, node, faults, f"unknown word '{node.text}'", suggestion(node.text, self.words))

    def schema(self) -> Schema:
        return {"enum": [*self.words, *self.also]}


_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+")
_WHOLE = re.compile(r"[+-]?[0-9]{1,15}")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class Number(OfText):
    """A plain number without a unit; the limits `minimum` and `maximum` are allowed values, `above` is not."""

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
            return refuse(
                self, node, faults, f"'{node.text}' has a decimal comma", f"write {node.text.replace(',', '.')}"
            )
        if not _NUMBER.fullmatch(node.text) or not math.isfinite(float(node.text)):
            return refuse(self, node, faults, f"'{node.text}' is not a plain number")
        if abs(float(node.text)) > units.LARGEST:
            return refuse(self, node, faults, f"{node.text} is too large", f"numbers reach up to {units.LARGEST:g}")
        return self.checked(node, float(node.text), faults)

    def checked(self, node: Node, value: float, faults: list[Fault]) -> Any:
        """Return `value`; if it is outside the limits, add a fault and return BAD."""
        low = (self.minimum is not None and value < self.minimum) or (self.above is not None and value <= self.above)
        if low or (self.maximum is not None and value > self.maximum):
            return refuse(self, node, faults, f"{node.text} is out of range")
        return value

    def schema(self) -> Schema:
        limits = {"minimum": self.minimum, "maximum": self.maximum, "exclusiveMinimum": self.above}
        return {"type": "number"} | {key: value for key, value in limits.items() if value is not None}


@dataclass(frozen=True)
class Whole(OfText):
    """A whole number; the limits are allowed values."""

    minimum: int | None = None
    maximum: int | None = None

    @property
    def expects(self) -> str:
        return f"a whole number{_limits((('at least', self.minimum), ('at most', self.maximum)))}"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node) or not _WHOLE.fullmatch(node.text):
            return refuse(self, node, faults)
        limits = Number(self.minimum, self.maximum).checked(node, int(node.text), [])
        return refuse(self, node, faults, f"{node.text} is out of range") if limits is BAD else int(node.text)

    def schema(self) -> Schema:
        limits = {"minimum": self.minimum, "maximum": self.maximum}
        return {"type": "integer"} | {key: value for key, value in limits.items() if value is not None}


def _limits(limits: Iterable[tuple[str, float | None]]) -> str:
    words = [f"{word} {limit:g}" for word, limit in limits if limit is not None]
    return f" of {' and '.join(words)}" if words else ""


@dataclass(frozen=True)
class QuantityLimits:
    """The range that a quantity has in its job, in its internal unit."""

    low: float
    high: float
    text: str
    """The range in words, and why"""

    def refuses(self, value: float) -> bool:
        """Return whether a value is outside."""
        return not self.low <= value <= self.high


@dataclass(frozen=True)
class WithUnit(OfText):
    """A number with its unit in one text, read as a float in the internal unit of its dimension."""

    dimension: str
    positive: bool = False
    """Whether zero and negative values are refused."""
    minimum: float | None = None
    """Smallest allowed value in the internal unit."""
    limits: QuantityLimits | None = None

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
        if self.limits is not None and self.limits.refuses(value):
            return refuse(self, node, faults, f"{node.text} is outside {self.limits.text}")
        if self.positive and value < units.SMALLEST:
            return refuse(self, node, faults, f"{node.text} is too small")
        allowed = units.range_of(self.dimension)
        if not allowed.holds(value):
            reach = f"{units.DIMENSIONS[self.dimension].phrase} is within {units.in_words(allowed, self.dimension)}"
            return refuse(self, node, faults, f"{node.text} is {'too large' if value > 0 else 'too low'}", reach)
        return value

    def schema(self) -> Schema:
        return {"type": "string", "pattern": units.quantity_pattern(self.dimension)}
