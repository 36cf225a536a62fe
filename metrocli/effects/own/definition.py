"""The definition of an effect of one's own, as a file has it under `define:`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metrocli.errors import Fault
from metrocli.expressions.written import AnyQuantity, Measure, Model, ModelText
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings import BAD, At, ListOf, MapOf, Placed, Schema, Section, Text, Whole, setting


@dataclass(frozen=True)
class Given:
    """A parameter of an effect."""

    unit: Placed = setting(At(Text()), "unit of the parameter, such as um, rad or 1")
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
            found = ModelText().read(node, faults)
            return BAD if found is BAD else {"": found}
        return MapOf(ModelText()).read(node, faults)

    def schema(self) -> Schema:
        return {"anyOf": [ModelText().schema(), MapOf(ModelText()).schema()]}


@dataclass(frozen=True)
class Definition:
    """An effect of one's own."""

    name: Placed = setting(At(Text()), "its name, in lower case with hyphens")
    acts_on: Placed = setting(At(Text()), "the quantity on which it acts; `metrocli effects KIND` lists them")
    adds: Mapping[str, Model] = setting(Adds(), "what it adds, in its parameters and the variables known there")
    parameters: Mapping[str, Given] = setting(
        MapOf(Section(Given)), "its parameters, each {unit: um, plausible: 50 um}"
    )
    cause: str = setting(Text(), "the cause in one sentence", default="a cause of one's own")
    where: tuple[Placed, ...] = setting(
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
