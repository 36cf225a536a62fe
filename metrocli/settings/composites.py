"""Specifications made of others: lists, maps, alternatives, and a value with its standard uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import make_dataclass
from itertools import compress
from typing import Any

from metrocli.errors import Fault
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings.sections import Section, setting
from metrocli.settings.values import BAD, Number, QuantityLimits, Schema, Spec, Whole, WithUnit, described, refuse
from metrocli.words import composed


@dataclass(frozen=True)
class ListOf:
    """A list of values of one kind, read as a tuple."""

    item: Spec
    length: int | None = None
    distinct: bool = False
    """Whether repeated values are refused."""

    @property
    def expects(self) -> str:
        return f"a list [...] of {self.length or 'values'}, each {self.item.expects}"

    def fits(self, node: Node) -> bool:
        return node.kind == "list"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return refuse(self, node, faults)
        if self.length is not None and len(node.items) != self.length:
            return refuse(self, node, faults, f"the list has {len(node.items)} values instead of {self.length}")
        values = tuple(self.item.read(item, faults) for item in node.items)
        again = [self.distinct and value is not BAD and value in values[:n] for n, value in enumerate(values)]
        repeated = [*compress(node.items, again)]
        faults.extend(item.fault(f"{node.path}: '{item.text}' is in the list twice") for item in repeated)
        return BAD if repeated or BAD in values else values

    def schema(self) -> Schema:
        sizes = {} if self.length is None else {"minItems": self.length, "maxItems": self.length}
        return {"type": "array", "items": self.item.schema()} | sizes | ({"uniqueItems": True} if self.distinct else {})


@dataclass(frozen=True)
class MapOf:
    """A mapping from names that the user chooses to values of one kind, read as a dict."""

    value: Spec

    @property
    def expects(self) -> str:
        return f"names with values, each {self.value.expects}"

    def fits(self, node: Node) -> bool:
        return node.kind == "mapping"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return refuse(self, node, faults)
        values = {composed(key.text): self.value.read(value, faults) for key, value in node.entries}
        return BAD if BAD in values.values() else values

    def schema(self) -> Schema:
        return {"type": "object", "additionalProperties": self.value.schema()}


@dataclass(frozen=True)
class LocatedValue:
    """A value with the node it was read from, for faults that are found later by comparison with other values."""

    value: Any
    node: Node


@dataclass(frozen=True)
class At:
    """A value whose place in the file the task needs as well; read as `LocatedValue`."""

    spec: Any

    @property
    def expects(self) -> str:
        return str(self.spec.expects)

    def fits(self, node: Node) -> bool:
        return bool(self.spec.fits(node))

    def read(self, node: Node, faults: list[Fault]) -> Any:
        value = self.spec.read(node, faults)
        return BAD if value is BAD else LocatedValue(value, node)

    def schema(self) -> Schema:
        schema: Schema = self.spec.schema()
        return schema


class Either:
    """One of several kinds of value; the first that can be read without a fault counts."""

    def __init__(self, *specs: Spec) -> None:
        self.specs = specs

    @property
    def expects(self) -> str:
        return ", or ".join(spec.expects for spec in self.specs)

    def fits(self, node: Node) -> bool:
        return any(spec.fits(node) for spec in self.specs)

    def read(self, node: Node, faults: list[Fault]) -> Any:
        shaped = [spec for spec in self.specs if spec.fits(node)]
        attempts = []
        for spec in shaped:
            below: list[Fault] = []
            value = spec.read(node, below)
            if value is not BAD and not below:
                return value
            attempts.append(below)
        faults.extend(self._telling(node, shaped, attempts))
        return BAD

    def _telling(self, node: Node, shaped: Sequence[Spec], attempts: Sequence[list[Fault]]) -> list[Fault]:
        """Return the faults of the alternative probably meant: text that begins like a number is a quantity."""
        numeric = node.kind == "scalar" and node.text[:1] in set("+-.0123456789")
        for spec, attempt in zip(shaped, attempts, strict=True):
            if len(shaped) == 1 or (numeric and isinstance(spec, WithUnit | Number | Whole)):
                return attempt
        return [node.fault(f"{node.path}: {described(node)}", f"expected {self.expects}")]

    def schema(self) -> Schema:
        return {"anyOf": [spec.schema() for spec in self.specs]}


_SPREADS = {"temperature": "temperature difference"}
"""Dimension of the standard uncertainty where it is not that of the value"""


@dataclass(frozen=True)
class KnownQuantity:
    """A quantity in its internal unit, nan if only its standard uncertainty is given."""

    value: float
    std: float = 0.0


UNKNOWN = KnownQuantity(float("nan"))
"""A quantity that a job does not give"""


class Uncertain:
    """A quantity, plain or {value, std}, read as `KnownQuantity`; the value may be absent if the file has a column."""

    def __init__(self, dimension: str, limits: QuantityLimits | None = None) -> None:
        quantity = WithUnit(dimension, limits=limits)
        value = setting(quantity, "the value", default=float("nan"))
        std = setting(
            WithUnit(_SPREADS.get(dimension, dimension), minimum=0.0), "its standard uncertainty", default=0.0
        )
        parts = make_dataclass("Parts", [("value", float, value), ("std", float, std)], frozen=True)
        self._given = Either(quantity, Section(parts))

    @property
    def expects(self) -> str:
        return self._given.expects

    def fits(self, node: Node) -> bool:
        return self._given.fits(node)

    def read(self, node: Node, faults: list[Fault]) -> Any:
        below = self._given.read(node, faults)
        if below is BAD:
            return BAD
        return KnownQuantity(below) if isinstance(below, float) else KnownQuantity(below.value, below.std)

    def schema(self) -> Schema:
        return self._given.schema()
