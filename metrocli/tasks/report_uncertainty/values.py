"""Values in report-uncertainty jobs: quantities of any unit, models, probabilities, limits, each with its place."""

from __future__ import annotations

import math
from typing import Any

from metrocli.errors import Fault
from metrocli.expressions.written import AnyQuantity
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings import BAD, Number, Schema

INFINITE = ("inf", ".inf", "infinite")


def _refused(node: Node, faults: list[Fault], message: str, hint: str) -> Any:
    faults.append(node.fault(f"{node.path}: {message}", hint))
    return BAD


@dataclass(frozen=True)
class Limit:
    """One end of a tolerance; `none` where there is no limit on that side."""

    expects = "a limit such as '50.001 mm', or none"

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if node.empty or node.text == "none":
            return None
        return AnyQuantity().read(node, faults)

    def schema(self) -> Schema:
        return {"anyOf": [{"type": "null"}, {"const": "none"}, AnyQuantity().schema()]}


@dataclass(frozen=True)
class Probability:
    """A number above 0 and below 1."""

    expects = "a probability such as 0.95"

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar" and not node.empty

    def read(self, node: Node, faults: list[Fault]) -> Any:
        value = Number().read(node, faults)
        if value is BAD or 0 < value < 1:
            return value
        hint = f"write {value / 100:g}" if 1 < value < 100 else f"expected {self.expects}"
        return _refused(node, faults, f"{node.text} is not a probability between 0 and 1", hint)

    def schema(self) -> Schema:
        return {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1}


@dataclass(frozen=True)
class DegreesOfFreedom:
    """A number above 0, or `inf`."""

    expects = "a number above 0, or inf"

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar" and not node.empty

    def read(self, node: Node, faults: list[Fault]) -> Any:
        return math.inf if node.text in INFINITE else Number(above=0).read(node, faults)

    def schema(self) -> Schema:
        return {"anyOf": [{"type": "number", "exclusiveMinimum": 0}, {"enum": list(INFINITE)}]}


@dataclass(frozen=True)
class Trials:
    """A number of trials, or `adaptive`."""

    expects = "a number of trials from 1000 to 1000000000, or adaptive, or 0 for none"

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar" and not node.empty

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if node.text == "adaptive":
            return None
        value = Number().read(node, [])
        if value is BAD or value != int(value) or not (value == 0 or 1000 <= value <= 1e9):
            return _refused(node, faults, f"'{node.text}' is not a number of trials", f"expected {self.expects}")
        return int(value)

    def schema(self) -> Schema:
        return {"anyOf": [{"const": "adaptive"}, {"type": "number", "minimum": 0, "maximum": 1e9}]}
