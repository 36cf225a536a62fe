"""Values in report-uncertainty jobs: quantities of any unit, models, probabilities, limits, each with its place."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from metrocli import units
from metrocli.errors import Fault
from metrocli.expressions.dimensions import Compound, compound
from metrocli.expressions.expression import Expression, ExpressionError, parse
from metrocli.nodes import Node
from metrocli.settings import BAD, Number, Schema

INFINITE = ("inf", ".inf", "infinite")
SMALLEST, LARGEST = 1e-100, 1e100
"""Range of values in base units whose squares and products do not overflow"""
_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_QUANTITY = re.compile(rf"({_NUMBER})\s*(.*)", re.DOTALL)
_COMMA = re.compile(r"([+-]?[0-9]*),([0-9]+)(.*)", re.DOTALL)


@dataclass(frozen=True)
class Measure:
    """A number with its unit, as written in the job."""

    number: float
    unit: Compound
    node: Node

    @property
    def value(self) -> float:
        """The value in base units."""
        return self.number * self.unit.factor

    def fault(self, message: str, hint: str | None = None) -> Fault:
        """Return a fault at the place of this value in the job."""
        return self.node.fault(f"{self.node.path}: {message}", hint)


@dataclass(frozen=True)
class AnyQuantity:
    """A number with any known unit or a product of units; a number without a unit is a plain number."""

    expects = "a number with its unit such as '50.000623 mm' or '1180 kg/m^3', or a plain number"

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar" and not node.empty

    def read(self, node: Node, faults: list[Fault]) -> Any:
        text = node.text.strip()
        match, comma = _QUANTITY.fullmatch(text), _COMMA.fullmatch(text)
        if not self.fits(node) or match is None or comma:
            hint = f"write {comma[1] or '0'}.{comma[2]}{comma[3]}" if comma else f"expected {self.expects}"
            said = f"'{text}' has a decimal comma" if comma else f"'{text}' is not a number with a unit"
            return _refused(node, faults, said if self.fits(node) else "there is no value", hint)
        try:
            unit = compound(match[2])
        except units.QuantityError as error:
            return _refused(node, faults, error.message, error.hint)
        measure = Measure(float(match[1]), unit, node)
        if measure.value and not SMALLEST <= abs(measure.value) <= LARGEST:
            return _refused(node, faults, f"'{text}' is out of range", "numbers reach from 1e-100 to 1e100")
        return measure

    def schema(self) -> Schema:
        return {"anyOf": [{"type": "number"}, {"type": "string", "pattern": rf"^\s*{_NUMBER}\s*\S*"}]}


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
class Model:
    """An expression with its place in the job."""

    expression: Expression
    node: Node

    def fault(self, error: ExpressionError) -> Fault:
        """Return the fault of an error in the model, at the column of the part that caused it."""
        return _at(self.node, error)


def _at(node: Node, error: ExpressionError) -> Fault:
    from dataclasses import replace

    fault = node.fault(f"{node.path}: {error.message}", error.hint)
    whole = node.line is not None and node.text in (node.source.lines[node.line - 1] if node.source.lines else "")
    if fault.column is None or not whole:
        return fault
    return replace(fault, column=fault.column + node.quoted + error.start)


@dataclass(frozen=True)
class ModelText:
    """A model such as `ls*(1 + alpha*theta)`."""

    expects = "an expression such as 'ls*(1 + alpha*theta) + d'"

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar" and not node.empty

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return _refused(node, faults, "there is no model", f"expected {self.expects}")
        try:
            return Model(parse(node.text), node)
        except ExpressionError as error:
            faults.append(_at(node, error))
            return BAD

    def schema(self) -> Schema:
        return {"type": ["string", "number"]}


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
