"""The key `ranges:` of a job: what the columns of its CSV files may hold, where that differs from what is usual."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from metrocli import units
from metrocli.errors import Fault
from metrocli.nodes import Node
from metrocli.settings import BAD, Schema, TableFile
from metrocli.words import suggestion


class Ranges:
    """The value of `ranges:`, the largest size of the values of a column, by its name without unit."""

    expects = "a mapping such as {phi1: 3600 deg}"

    def fits(self, node: Node) -> bool:
        return node.kind == "mapping"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if self.fits(node):
            return {name.text: value for name, value in node.entries}
        faults.append(node.fault("ranges: this is not a mapping", f"expected {self.expects}"))
        return BAD

    def schema(self) -> Schema:
        return {"type": "object", "additionalProperties": {"type": "string"}}


def ranges_of(wanted: Mapping[str, Node], specs: Iterable[Any], faults: list[Fault]) -> dict[str, units.Range]:
    """Return the ranges of columns; a fault is added for each name that no file has and each size that is no size."""
    tables = [spec for spec in specs if isinstance(spec, TableFile)]
    columns = {column.name: column.dimension for spec in tables for column in spec.columns.columns}
    columns = {name: dimension for name, dimension in columns.items() if dimension in units.DIMENSIONS}
    found = {}
    for name, node in wanted.items():
        if name not in columns:
            message = f"ranges: no file of this job has a column '{name}' with a unit"
            faults.append(node.fault(message, suggestion(name, columns)))
            continue
        try:
            size = units.parse_quantity(node.text, columns[name])
        except units.QuantityError as error:
            faults.append(node.fault(f"{node.path}: {error.message}", error.hint))
            continue
        usual = units.range_of(columns[name])
        if 0 < size <= units.LARGEST:
            found[name] = units.Range(usual.low if usual.low != -usual.high else -size, size)
        else:
            faults.append(
                node.fault(f"{node.path}: {node.text} is not the size of a number", "write a size above zero")
            )
    return found


def within(spec: Any, ranges: Mapping[str, units.Range]) -> Any:
    """Return the specification of an input with the ranges of its columns; what is no table is unchanged."""
    if not isinstance(spec, TableFile) or not ranges:
        return spec
    columns = tuple(replace(column, allowed=ranges.get(column.name)) for column in spec.columns.columns)
    return TableFile(replace(spec.columns, columns=columns))
