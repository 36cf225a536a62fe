"""One definition of a user-defined effect: its names, parameters and texts."""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from metrocli import units
from metrocli.arrays import Array
from metrocli.effects.acting import ALONG, Acting
from metrocli.effects.effect import Parameter
from metrocli.errors import Fault
from metrocli.expressions.dimensions import Compound, base_unit
from metrocli.expressions.expression import CONSTANTS, FUNCTIONS, NAME, ExpressionError
from metrocli.expressions.written import AnyQuantity, Measure, ModelText, WrittenExpression
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings import BAD, At, ListOf, LocatedValue, MapOf, Schema, Section, Text, Whole, setting
from metrocli.words import in_a_row

WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_KEYS = ("name", "by", "std")
"""Keys of `effects:` that no parameter can have as its name"""
_OTHER = "choose another name"


_ABSURD = 1e15
"""Multiple of its own unit, or part of it, from which a plausible size is a slip of the pen"""


def not_free(
    given: tuple[Iterable[str], Iterable[str]], known: Container[str], where: Sequence[str]
) -> Iterator[tuple[str, str, str]]:
    """Yield key, fault and hint for each parameter and scanned parameter (`given`) whose name is not free."""
    parameters, scan = given
    seen: set[str] = set()
    for key, name in [*(("parameters", name) for name in parameters), *(("scan", name) for name in scan)]:
        if not WORD.fullmatch(name):
            yield f"{key}.{name}", f"'{name}' is not a name", "write letters, digits and _"
        elif name in (*FUNCTIONS, *CONSTANTS, *_KEYS, *where):
            yield f"{key}.{name}", f"'{name}' has a meaning of its own", _OTHER
        elif name in known:
            yield f"{key}.{name}", f"'{name}' is a variable there", _OTHER
        elif name in seen:
            yield f"{key}.{name}", f"'{name}' is also under parameters", _OTHER
        seen.add(name)


def constants_of_data(expression: str, refused: Mapping[str, str]) -> Iterator[ExpressionError]:
    """Yield an error for each constant in an expression that is the name of a column too; `refused` has the remedy."""
    for name, value in CONSTANTS.items():
        match = re.search(rf"\b{name}\b", expression)
        if match is not None and name in refused:
            message = f"'{name}' is {value:.6g}, and a column of the data has this name"
            yield ExpressionError(message, match.start(), refused[name])


def lacking(unknown: Mapping[str, str], unclear: Iterable[ExpressionError]) -> str:
    """Return why the data do not have an effect: constants that are columns too, and unknown names with their hints."""
    names = [f"{name} ({hint})" if hint else name for name, hint in unknown.items()]
    texts = dict.fromkeys(f"{fault.message} ({fault.hint})" for fault in unclear)
    return "; ".join([*texts, *([f"needs a column {in_a_row(names)}"] if names else [])])


_FINER = 100
"""Values by which the best one of a scan is refined, in one of its steps"""
_NOT_MEANT = ("wavelength", "temperature", "slope", "humidity", "frequency")
"""Dimensions that share their units with the one that a parameter has"""


def components(acting: Acting, where: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the components that an effect with these kinds of place can change."""
    along = (ALONG,) if "axis" in where and "axis" in acting.where and len(acting.components) > 1 else ()
    return (*acting.components, *along)


def shape(components: Sequence[str]) -> str:
    """Return how `adds` is written for a quantity with these components, for messages."""
    if components == ("",):
        return "adds: EXPRESSION"
    return f"adds: {{{components[0]}: EXPRESSION}}; components: {', '.join(components)}"


def of_unit(
    name: str,
    text: str,
    unit: Compound | None,
    plausible: float,
    grid: Callable[[Mapping[str, Array]], Array] | None = None,
    tried: int = 120,
) -> Parameter:
    """Return a parameter with the dimension of its unit, or with base units if no dimension has that unit."""
    symbol = units.plain_symbol(text.strip())
    if unit is None or symbol in ("", "1"):
        return Parameter(name, "", plausible, grid=grid, tried=tried)
    for dimension in units.DIMENSIONS.values():
        if symbol in dimension.symbols and dimension.coherent == 1.0 and dimension.name not in _NOT_MEANT:
            return Parameter(name, dimension.name, plausible, grid=grid, tried=tried)
    # with negative powers last: mm s-2
    base = base_unit(tuple(sorted(unit.powers, key=lambda power: power[1] < 0)))
    plain = Parameter(name, "", plausible, grid=grid, tried=tried, base=base)
    return replace(plain, shown=text.strip(), given=unit.factor)


def absurdity(parameter: Parameter, size: Measure, unit: Compound) -> str:
    """Return what is absurd in a plausible size of a parameter with this unit, "" if nothing is."""
    if not size.value > 0:
        return "a plausible size is above zero"
    believed = 1 / _ABSURD < size.value / unit.factor < _ABSURD and units.range_of(parameter.dimension).holds(
        size.value
    )
    return "" if believed else f"no effect has a size of {size.node.text}"


def values_tried(name: str, scan: Scan, adds: Iterable[WrittenExpression]) -> Array:
    """Return the values of a scan, even in 1/value for a name that only divides, such as a period, else even.

    Between those that are tried are those by which the best one is refined.
    """
    low, high, count = scan.low.value, scan.high.value, (scan.steps - 1) * _FINER + 1
    if low > 0 and all(_only_divides(model, name) for model in adds):
        return np.asarray(1 / np.linspace(1 / high, 1 / low, count))
    return np.linspace(low, high, count)


def _only_divides(model: WrittenExpression, name: str) -> bool:
    """Return whether a name occurs in an expression only behind a division sign, as the period of a wave does."""
    text = model.expression.text
    named = [part for part in model.expression.parts if part.operation == NAME and part.name == name]
    return all(text[: part.start].rstrip().endswith("/") for part in named)


@dataclass(frozen=True)
class Given:
    """A parameter of an effect."""

    unit: LocatedValue = setting(At(Text()), "unit of the parameter, such as um, rad or 1")
    plausible: Measure = setting(AnyQuantity(), "largest size that can be believed, such as 50 um")


@dataclass(frozen=True)
class Scan:
    """A parameter that is tried at several values instead of being estimated."""

    low: Measure = setting(AnyQuantity(), "smallest value, such as 2 mm", key="from")
    high: Measure = setting(AnyQuantity(), "largest value, such as 100 mm", key="to")
    steps: int = setting(Whole(2, 10_000), "number of values", default=60)


@dataclass(frozen=True)
class Adds:
    """Value of `adds`: one expression, or one for each component that the effect changes."""

    expects = "an expression such as 'a*t', or one for each component: {x: 'a*t'}"

    def fits(self, node: Node) -> bool:
        return node.kind == "mapping" or ModelText().fits(node)

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if node.kind != "mapping":
            expression = ModelText().read(node, faults)
            return BAD if expression is BAD else {"": expression}
        return MapOf(ModelText()).read(node, faults)

    def schema(self) -> Schema:
        return {"anyOf": [ModelText().schema(), MapOf(ModelText()).schema()]}


@dataclass(frozen=True)
class Definition:
    """A user-defined effect."""

    name: LocatedValue = setting(At(Text()), "its name, in lower case with hyphens")
    acts_on: LocatedValue = setting(At(Text()), "the quantity on which it acts; `metrocli effects KIND` lists them")
    adds: Mapping[str, WrittenExpression] = setting(
        Adds(), "what it adds, in its parameters and the variables known there"
    )
    parameters: Mapping[str, Given] = setting(
        MapOf(Section(Given)), "its parameters, each {unit: um, plausible: 50 um}"
    )
    cause: str = setting(Text(), "the cause in one sentence", default="a user-defined cause")
    where: tuple[LocatedValue, ...] = setting(
        ListOf(At(Text())), "kinds of place, with sizes of its own at each, such as [tracer]", default=()
    )
    scan: Mapping[str, Scan] = setting(
        MapOf(Section(Scan)),
        "parameters that are tried, not estimated: {from: 2 mm, to: 100 mm, steps: 60}",
        default={},
    )
    reveal: str = setting(Text(), "what to measure to detect it", default="")
    source: str = setting(Text(), "where it is described", default="")


def text_of(node: Node) -> str:
    """Return a node as one line of YAML: what the result file keeps of a definition."""
    if node.kind == "list":
        return f"[{', '.join(map(text_of, node.items))}]"
    if node.kind == "mapping":
        return "{" + ", ".join(f"{key.text}: {text_of(value)}" for key, value in node.entries) + "}"
    plain = not any(mark in node.text for mark in "{}[],:#'\"&*!|>%@`") and node.text == node.text.strip()
    escaped = node.text.replace("'", "''")
    return node.text if plain and node.text else f"'{escaped}'"
