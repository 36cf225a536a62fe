"""Quantities with a standard uncertainty: plain, or as {value, std}."""

from __future__ import annotations

from dataclasses import make_dataclass
from typing import Any

from metrocli.errors import Fault
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings.composites import Either
from metrocli.settings.sections import Section, setting
from metrocli.settings.values import BAD, Limits, Quantity, Schema

_SPREADS = {"temperature": "temperature difference"}
"""Dimension of the standard uncertainty where it is not that of the value"""


@dataclass(frozen=True)
class Known:
    """A quantity in its internal unit, nan if only its standard uncertainty is given."""

    value: float
    std: float = 0.0


UNKNOWN = Known(float("nan"))
"""A quantity that a job does not give"""


class Uncertain:
    """A quantity, plain or as {value, std}, read as `Known`; the value may be absent where the file has a column."""

    def __init__(self, dimension: str, limits: Limits | None = None) -> None:
        quantity = Quantity(dimension, limits=limits)
        value = setting(quantity, "the value", default=float("nan"))
        std = setting(
            Quantity(_SPREADS.get(dimension, dimension), minimum=0.0), "its standard uncertainty", default=0.0
        )
        parts = make_dataclass("Parts", [("value", float, value), ("std", float, std)], frozen=True)
        self._given = Either(quantity, Section(parts))

    @property
    def expects(self) -> str:
        return self._given.expects

    def fits(self, node: Node) -> bool:
        return self._given.fits(node)

    def read(self, node: Node, faults: list[Fault]) -> Any:
        found = self._given.read(node, faults)
        if found is BAD:
            return BAD
        return Known(found) if isinstance(found, float) else Known(found.value, found.std)

    def schema(self) -> Schema:
        return self._given.schema()
