"""What a job changes of its files: values of --set and --effect, and ranges of columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from metrocli import units
from metrocli.errors import Fault, UsageError
from metrocli.nodes import Node, Source, with_paths, without_lines
from metrocli.project import yaml_text
from metrocli.settings import BAD, Schema, TableFile
from metrocli.words import suggestion


def overridden(root: Node, override: str, folder: Path) -> Node:
    """Return a job with one `key.path=value` applied; raise UsageError if it cannot be.

    Entries of lists are counted from 1; keys that are missing are added.
    """
    key, equals, value = override.partition("=")
    names = key.strip().split(".")
    if not equals or not all(names):
        raise UsageError(f"--set {override}: write it as key.path=value, such as --set output=other.h5")
    # a condition such as > 0.5 is not a block of YAML
    text = f"'{value}'" if value.startswith(">") and "'" not in value else value or "~"
    new = yaml_text.parse(text, f"--set {override}", folder)
    return with_paths(_replaced(root, names, without_lines(new)))


def _replaced(node: Node, names: Sequence[str], new: Node) -> Node:
    if not names:
        return new
    if node.kind == "list" and names[0].isascii() and names[0].isdigit():
        items, number = list(node.items), int(names[0])
        if not 0 < number <= len(items):
            raise UsageError(f"--set: '{node.path}' has {len(items)} entries, counted from 1; there is no {number}")
        items[number - 1] = _replaced(items[number - 1], names[1:], new)
        return replace(node, items=tuple(items))
    if node.kind != "mapping":
        node = replace(node, kind="mapping", text="", entries=(), items=())
    names = _as_keys(node, names)
    at = next((n for n, (key, _) in enumerate(node.entries) if key.text == names[0]), None)
    if at is None:
        key = replace(new, kind="scalar", text=names[0], quoted=False, entries=(), items=())
        path = names[0] if not node.path else ""
        below = replace(new, kind="mapping", text="", quoted=False, entries=(), items=(), path=path)
        return replace(node, entries=(*node.entries, (key, _replaced(below, names[1:], new))))
    key, value = node.entries[at]
    changed = (key, _replaced(value, names[1:], new))
    return replace(node, entries=(*node.entries[:at], changed, *node.entries[at + 1 :]))


def _as_keys(node: Node, names: Sequence[str]) -> Sequence[str]:
    """Return names of which the first is a key of a mapping: figures and estimates have points in their names.

    It is the longest key that the mapping has. All that `require` has are names of figures.
    """
    keys = {key.text for key, _ in node.entries}
    least = len(names) if node.path == "require" else 1
    for count in range(len(names), least, -1):
        if ".".join(names[:count]) in keys:
            return [".".join(names[:count]), *names[count:]]
    return [".".join(names[:least]), *names[least:]]


def effect_node(text: str, folder: Path) -> Node:
    """Return an effect of the command line, `NAME:key=value,...`, as a node of a job; raise UsageError if malformed."""
    name, _, rest = text.partition(":")
    pairs = [part.partition("=") for part in rest.split(",") if part.strip()]
    if not name.strip() or not all(key.strip() and equals for key, equals, _ in pairs):
        raise UsageError(f"--effect {text}: write it as NAME:key=value,key=value, such as dead-path-drift:tracer=LT2")
    source = Source(f"--effect {text}", (), folder)

    def word(value: str) -> Node:
        return Node("scalar", source, text=value.strip())

    entries = tuple((word(key), word(value)) for key, value in (("name", name), *((k, v) for k, _, v in pairs)))
    return with_paths(Node("mapping", source, entries=entries))


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
    """Return the ranges of columns; each name that no file has and each size that is not a size becomes a fault."""
    tables = [spec for spec in specs if isinstance(spec, TableFile)]
    columns = {column.name: column.dimension for spec in tables for column in spec.columns.columns}
    columns = {name: dimension for name, dimension in columns.items() if dimension in units.DIMENSIONS}
    ranges = {}
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
            ranges[name] = units.Range(usual.low if usual.low != -usual.high else -size, size)
        else:
            faults.append(
                node.fault(f"{node.path}: {node.text} is not the size of a number", "write a size above zero")
            )
    return ranges


def within(spec: Any, ranges: Mapping[str, units.Range]) -> Any:
    """Return the specification of an input with the ranges of its columns; what is not a table is unchanged."""
    if not isinstance(spec, TableFile) or not ranges:
        return spec
    columns = tuple(replace(column, allowed=ranges.get(column.name)) for column in spec.columns.columns)
    return TableFile(replace(spec.columns, columns=columns))
