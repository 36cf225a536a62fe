"""Expressions and quantities in a job file, read with their place: an error points at the part that caused it."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from metrocli import units
from metrocli.errors import Fault
from metrocli.expressions.dimensions import Compound, compound, described
from metrocli.expressions.expression import Expression, ExpressionError, parse
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings import BAD, Schema
from metrocli.settings.values import OfText, refuse

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
class AnyQuantity(OfText):
    """A number with any known unit or a product of units; a number without a unit is a plain number."""

    expects = "a number with its unit such as '50.000623 mm' or '1180 kg/m^3', or a plain number"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        text = node.text.strip()
        match, comma = _QUANTITY.fullmatch(text), _COMMA.fullmatch(text)
        if not self.fits(node) or match is None or comma:
            hint = f"write {comma[1] or '0'}.{comma[2]}{comma[3]}" if comma else f"expected {self.expects}"
            message = f"'{text}' has a decimal comma" if comma else f"'{text}' is not a number with a unit"
            return refuse(self, node, faults, message if self.fits(node) else "there is no value", hint)
        try:
            unit = compound(match[2])
        except units.QuantityError as error:
            return refuse(self, node, faults, error.message, error.hint)
        measure = Measure(float(match[1]), unit, node)
        if measure.value and not SMALLEST <= abs(measure.value) <= LARGEST:
            return refuse(self, node, faults, f"'{text}' is out of range", "numbers reach from 1e-100 to 1e100")
        return measure

    def schema(self) -> Schema:
        return {"anyOf": [{"type": "number"}, {"type": "string", "pattern": rf"^\s*{_NUMBER}\s*\S*"}]}


@dataclass(frozen=True)
class OfUnit:
    """A number with a unit that agrees with a given one, such as "mm s-2"; read as a float in base units."""

    unit: str

    @property
    def expects(self) -> str:
        return f"a number with a unit, such as '1 {self.unit}'"

    def fits(self, node: Node) -> bool:
        return AnyQuantity().fits(node)

    def read(self, node: Node, faults: list[Fault]) -> Any:
        measure = AnyQuantity().read(node, faults)
        if measure is BAD or measure.unit.powers == compound(self.unit).powers:
            return measure if measure is BAD else measure.value
        return refuse(self, node, faults, f"'{node.text}' is {described(measure.unit)}")

    def schema(self) -> Schema:
        return AnyQuantity().schema()


@dataclass(frozen=True)
class WrittenExpression:
    """An expression with its place in the job."""

    expression: Expression
    node: Node

    def fault(self, error: ExpressionError) -> Fault:
        """Return the fault of an error in the model, at the column of the part that caused it."""
        return fault_in(self.node, error)


def fault_in(node: Node, error: ExpressionError) -> Fault:
    """Return the fault of an error in the expression of a node, at the column of the part that caused it."""
    fault = node.fault(f"{node.path}: {error.message}", error.hint)
    whole = node.line is not None and node.text in (node.source.lines[node.line - 1] if node.source.lines else "")
    if fault.column is None or not whole:
        return fault
    return replace(fault, column=fault.column + node.quoted + error.start)


@dataclass(frozen=True)
class ModelText(OfText):
    """A model such as `ls*(1 + alpha*theta)`."""

    expects = "an expression such as 'ls*(1 + alpha*theta) + d'"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return refuse(self, node, faults, "there is no model")
        try:
            return WrittenExpression(parse(node.text), node)
        except ExpressionError as error:
            faults.append(fault_in(node, error))
            return BAD

    def schema(self) -> Schema:
        return {"type": ["string", "number"]}
