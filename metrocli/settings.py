"""What a job file may say: specifications that read a plain tree of nodes into frozen dataclasses, and a JSON schema.

Values are read from the text as it stands in the file, never from a type that YAML made of it: `1e-6` is a number,
`012345` a serial number. Every fault is collected with its place, so that one run shows them all.
"""

from __future__ import annotations

import dataclasses
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from metrocli import units
from metrocli.errors import Fault
from metrocli.nodes import Node
from metrocli.words import suggestion

Schema = dict[str, Any]


class _Bad:
    """The value of something with a fault; it never reaches a task."""

    def __repr__(self) -> str:
        return "BAD"


BAD = _Bad()


class Spec(Protocol):
    """How one value is read and described."""

    @property
    def expects(self) -> str:
        """What may stand here, in words: "a length such as 0.1 mm"."""

    def fits(self, node: Node) -> bool:
        """Tell whether the node has the shape of this value, so that its faults are worth telling."""

    def read(self, node: Node, faults: list[Fault]) -> Any:
        """Return the value, or add to `faults` and return BAD."""

    def schema(self) -> Schema:
        """Return the JSON schema (2020-12) of the value."""


def _refuse(spec: Spec, node: Node, faults: list[Fault], reason: str = "", hint: str | None = None) -> Any:
    found = reason or _described(node)
    faults.append(node.fault(f"{node.path}: {found}", hint or f"expected {spec.expects}"))
    return BAD


def _described(node: Node) -> str:
    if node.empty:
        return "there is no value"
    return f"'{node.text}' is not expected here" if node.kind == "scalar" else f"a {node.kind} is not expected here"


class _OfText:
    """What all values written as one word, number or text have in common."""

    def fits(self, node: Node) -> bool:
        return node.kind == "scalar" and not node.empty


@dataclass(frozen=True)
class Text(_OfText):
    """Any text, as it stands in the file."""

    expects = "text"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        return node.text if self.fits(node) else _refuse(self, node, faults)

    def schema(self) -> Schema:
        return {"type": ["string", "number", "boolean"]}


@dataclass(frozen=True)
class Flag(_OfText):
    """true or false."""

    expects = "true or false"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        words = {"true": True, "false": False}
        return words[node.text] if self.fits(node) and node.text in words else _refuse(self, node, faults)

    def schema(self) -> Schema:
        return {"type": "boolean"}


class Choice(_OfText):
    """One of a few words."""

    def __init__(self, *words: str) -> None:
        self.words = words

    @property
    def expects(self) -> str:
        return self.words[0] if len(self.words) == 1 else f"one of: {', '.join(self.words)}"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return _refuse(self, node, faults)
        if node.text in self.words:
            return node.text
        return _refuse(self, node, faults, f"unknown word '{node.text}'", suggestion(node.text, self.words))

    def schema(self) -> Schema:
        return {"enum": list(self.words)}


_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+")
_WHOLE = re.compile(r"[+-]?[0-9]{1,15}")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


@dataclass(frozen=True)
class Number(_OfText):
    """A plain number without a unit, within limits that belong to it (`above`: not itself)."""

    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None

    @property
    def expects(self) -> str:
        limits = (("above", self.above), ("at least", self.minimum), ("at most", self.maximum))
        return f"a number{_limits(limits)}"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return _refuse(self, node, faults)
        if _COMMA.fullmatch(node.text):
            return _refuse(self, node, faults, "has a decimal comma", f"write {node.text.replace(',', '.')}")
        if not _NUMBER.fullmatch(node.text) or not math.isfinite(float(node.text)):
            return _refuse(self, node, faults, f"'{node.text}' is not a plain number")
        return self.within(node, float(node.text), faults)

    def within(self, node: Node, value: float, faults: list[Fault]) -> Any:
        """Return the value, BAD with a fault where it is outside the limits."""
        low = (self.minimum is not None and value < self.minimum) or (self.above is not None and value <= self.above)
        if low or (self.maximum is not None and value > self.maximum):
            return _refuse(self, node, faults, f"{node.text} is out of range")
        return value

    def schema(self) -> Schema:
        limits = {"minimum": self.minimum, "maximum": self.maximum, "exclusiveMinimum": self.above}
        return {"type": "number"} | {key: value for key, value in limits.items() if value is not None}


@dataclass(frozen=True)
class Whole(_OfText):
    """A whole number, within limits that belong to it."""

    minimum: int | None = None
    maximum: int | None = None

    @property
    def expects(self) -> str:
        return f"a whole number{_limits((('at least', self.minimum), ('at most', self.maximum)))}"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node) or not _WHOLE.fullmatch(node.text):
            return _refuse(self, node, faults)
        limits = Number(self.minimum, self.maximum).within(node, int(node.text), [])
        return _refuse(self, node, faults, f"{node.text} is out of range") if limits is BAD else int(node.text)

    def schema(self) -> Schema:
        limits = {"minimum": self.minimum, "maximum": self.maximum}
        return {"type": "integer"} | {key: value for key, value in limits.items() if value is not None}


def _limits(limits: Iterable[tuple[str, float | None]]) -> str:
    words = [f"{word} {limit:g}" for word, limit in limits if limit is not None]
    return f" of {' and '.join(words)}" if words else ""


@dataclass(frozen=True)
class Quantity(_OfText):
    """A number with its unit in one text, read as a float in the internal unit of its dimension."""

    dimension: str
    positive: bool = False
    """Refuse zero and below."""
    minimum: float | None = None
    """In the internal unit."""

    @property
    def expects(self) -> str:
        dimension = units.DIMENSIONS[self.dimension]
        return f"{dimension.phrase} such as '{dimension.example}'"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return _refuse(self, node, faults)
        try:
            value = units.parse_quantity(node.text, self.dimension)
        except units.QuantityError as error:
            return _refuse(self, node, faults, error.message, error.hint)
        if self.positive and value <= 0:
            return _refuse(self, node, faults, f"{node.text} is not above zero")
        if self.minimum is not None and value < self.minimum:
            return _refuse(self, node, faults, f"{node.text} is too small")
        return value

    def schema(self) -> Schema:
        return {"type": "string", "pattern": units.quantity_pattern(self.dimension)}


@dataclass(frozen=True)
class ListOf:
    """A list of values of one kind, read as a tuple."""

    item: Spec
    length: int | None = None
    distinct: bool = False
    """Refuse a value that stands in the list twice."""

    @property
    def expects(self) -> str:
        return f"a list [...] of {self.length or 'values'}, each {self.item.expects}"

    def fits(self, node: Node) -> bool:
        return node.kind == "list"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node):
            return _refuse(self, node, faults)
        if self.length is not None and len(node.items) != self.length:
            return _refuse(self, node, faults, f"the list has {len(node.items)} values instead of {self.length}")
        values = tuple(self.item.read(item, faults) for item in node.items)
        repeated = [item for n, item in enumerate(node.items) if self.distinct and values[n] in values[:n]]
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
            return _refuse(self, node, faults)
        values = {key.text: self.value.read(value, faults) for key, value in node.entries}
        return BAD if BAD in values.values() else values

    def schema(self) -> Schema:
        return {"type": "object", "additionalProperties": self.value.schema()}


@dataclass(frozen=True)
class Placed:
    """A value with the node it was read from, for faults that only show beside others."""

    value: Any
    node: Node


@dataclass(frozen=True)
class At:
    """A value of which the task wants the place too: read as `Placed`."""

    spec: Any

    @property
    def expects(self) -> str:
        return str(self.spec.expects)

    def fits(self, node: Node) -> bool:
        return bool(self.spec.fits(node))

    def read(self, node: Node, faults: list[Fault]) -> Any:
        value = self.spec.read(node, faults)
        return BAD if value is BAD else Placed(value, node)

    def schema(self) -> Schema:
        schema: Schema = self.spec.schema()
        return schema


class Either:
    """One of several kinds of value; the first that reads without a fault."""

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
            found: list[Fault] = []
            value = spec.read(node, found)
            if value is not BAD and not found:
                return value
            attempts.append(found)
        faults.extend(self._telling(node, shaped, attempts))
        return BAD

    def _telling(self, node: Node, shaped: Sequence[Spec], attempts: Sequence[list[Fault]]) -> list[Fault]:
        """Choose the faults of the alternative that was meant: a text that begins like a number is a quantity."""
        numeric = node.kind == "scalar" and node.text[:1] in set("+-.0123456789")
        for spec, found in zip(shaped, attempts, strict=True):
            if len(shaped) == 1 or (numeric and isinstance(spec, Quantity | Number | Whole)):
                return found
        return [node.fault(f"{node.path}: {_described(node)}", f"expected {self.expects}")]

    def schema(self) -> Schema:
        return {"anyOf": [spec.schema() for spec in self.specs]}


@dataclass(frozen=True)
class TableFile(_OfText):
    """A CSV file beside the job; `columns` (`table.Columns`) says what is read from it."""

    columns: Any
    expects = "the path of a CSV file"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        path = _path(self, node, faults)
        if path is not BAD and path.suffix.lower() in (".h5", ".hdf5", ".yaml", ".yml"):
            return _refuse(self, node, faults, f"'{node.text}' is not a CSV file")
        return path

    def schema(self) -> Schema:
        return {"type": "string", "minLength": 1}


@dataclass(frozen=True)
class ImageFiles:
    """Images beside the job: a path, a pattern such as img/*.jpg, or a list of them; read as sorted paths."""

    expects = "the path of an image, or a pattern such as img/*.jpg"

    def fits(self, node: Node) -> bool:
        return node.kind == "list" or (node.kind == "scalar" and not node.empty)

    def read(self, node: Node, faults: list[Fault]) -> Any:
        if not self.fits(node) or (node.kind == "list" and not node.items):
            return _refuse(self, node, faults)
        each = [_path(self, part, faults) for part in (node.items or (node,))]
        if BAD in each:
            return BAD
        return tuple(sorted({path for part in (node.items or (node,)) for path in _matches(part)}))

    def unmatched(self, node: Node) -> list[Node]:
        """Return the patterns that no file matches."""
        return [part for part in (node.items or (node,)) if not _matches(part)]

    def schema(self) -> Schema:
        one = {"type": "string", "minLength": 1}
        return {"anyOf": [one, {"type": "array", "items": one, "minItems": 1}]}


def _matches(node: Node) -> list[Path]:
    """Return the files of a pattern; a plain path as it is, whether it exists or not."""
    if not set(node.text) & set("*?["):
        return [path_beside(node)]
    return [Path(os.path.normpath(path)) for path in _glob(node) if path.is_file()]


def _glob(node: Node) -> Iterable[Path]:
    pattern = Path(node.text)
    if pattern.is_absolute():
        return Path(pattern.anchor).glob(str(pattern.relative_to(pattern.anchor)))
    return node.source.folder.glob(node.text)


ANY_KIND = ("any kind of job",)
"""For `FileOf`: results of all kinds are taken"""


@dataclass(frozen=True)
class FileOf(_OfText):
    """The result of another job (.h5), or a YAML file with the same facts written by hand."""

    results: tuple[str, ...] = ()
    """Kinds of job whose result is taken."""
    section: type | None = None
    """The dataclass that a YAML file is read into."""

    @property
    def expects(self) -> str:
        kinds = [f"the .h5 result of {' or '.join(self.results)}"] if self.results else []
        return ", or ".join(kinds + (["a .yaml file"] if self.section else []))

    def read(self, node: Node, faults: list[Fault]) -> Any:
        path = _path(self, node, faults)
        endings = ((".h5", ".hdf5") if self.results else ()) + ((".yaml", ".yml") if self.section else ())
        if path is not BAD and path.suffix.lower() not in endings:
            return _refuse(self, node, faults, f"'{node.text}' does not end in {' or '.join(endings)}")
        return path

    def schema(self) -> Schema:
        return {"type": "string", "minLength": 1}


def _path(spec: Spec, node: Node, faults: list[Fault]) -> Any:
    if node.kind != "scalar" or node.empty or not node.text.strip() or "\0" in node.text:
        return _refuse(spec, node, faults)
    return path_beside(node)


def path_beside(node: Node) -> Path:
    """Return the path that a node names, without `..` in the middle, so that two jobs name a file alike."""
    return Path(os.path.normpath(node.source.folder / node.text))


@dataclass(frozen=True)
class Setting:
    """What the metadata of a dataclass field says about one key of a job."""

    spec: Spec
    description: str
    key: str


def setting(spec: Spec, description: str, default: Any = dataclasses.MISSING, key: str = "") -> Any:
    """Return the field of one key, required without a default; `key` is its name where Python reserves it."""
    metadata = {"setting": (spec, description, key)}
    if isinstance(default, Mapping | list):
        return field(default_factory=lambda: default, metadata=metadata)
    return field(default=default, metadata=metadata)


def settings_of(section: type) -> dict[str, tuple[Setting, bool]]:
    """Return by field name each setting of a dataclass, and whether it is required."""
    found = {}
    for item in dataclasses.fields(section):
        spec, description, key = item.metadata["setting"]
        required = item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING
        found[item.name] = (Setting(spec, description, key or item.name), required)
    return found


@dataclass(frozen=True)
class Section:
    """A mapping with known keys, read into a frozen dataclass whose fields are settings."""

    section: type

    @property
    def expects(self) -> str:
        keys = (wanted.key for wanted, _ in settings_of(self.section).values())
        return f"a mapping with the keys {', '.join(keys)}"

    def fits(self, node: Node) -> bool:
        return node.kind == "mapping"

    def read(self, node: Node, faults: list[Fault]) -> Any:
        return read_sections(node, (self.section,), faults)[0]

    def schema(self) -> Schema:
        return sections_schema((self.section,))


def read_sections(node: Node, sections: Sequence[type], faults: list[Fault]) -> list[Any]:
    """Read one mapping into several dataclasses that share its keys; BAD for each that has a fault."""
    if node.kind != "mapping":
        return [_refuse(Section(section), node, faults) for section in sections]
    known = [wanted.key for section in sections for wanted, _ in settings_of(section).values()]
    place = f" in '{node.path}'" if node.path else ""
    unknown = [key for key, _ in node.entries if key.text not in known]
    faults.extend(key.fault(f"unknown key '{key.text}'{place}", _hint_for_key(key.text, known)) for key in unknown)
    return [_read_section(node, section, faults) for section in sections]


def _hint_for_key(key: str, known: Sequence[str]) -> str:
    """Return the nearest key, or the reason where a comma in {...} cut a value in two."""
    if re.fullmatch(r"[0-9]+\s*[^\W\d_]*", key):
        return "a comma ends a value here; write a decimal point, and the value in quotes if it must hold a comma"
    return suggestion(key, known)


def _read_section(node: Node, section: type, faults: list[Fault]) -> Any:
    values: dict[str, Any] = {}
    missing = []
    for name, (wanted, required) in settings_of(section).items():
        below = node.get(wanted.key)
        if below is not None:
            values[name] = wanted.spec.read(below, faults)
        elif required:
            missing.append(wanted)
    place = f" in '{node.path}'" if node.path else ""
    for wanted in missing:
        hint = f"{wanted.description}: {wanted.spec.expects}"
        faults.append(node.fault(f"the key '{wanted.key}' is missing{place}", hint))
    if missing or BAD in values.values():
        return BAD
    return _checked(section(**values), node, faults)


def _checked(value: Any, node: Node, faults: list[Fault]) -> Any:
    """Add the faults that a section finds across its keys: `(key path, message[, hint])`, or a Fault with its place."""
    check = getattr(value, "faults", None)
    said = list(check()) if check else []
    found = [item if isinstance(item, Fault) else node.at(item[0]).fault(*item[1:]) for item in said]
    faults.extend(found)
    return BAD if found else value


def sections_schema(sections: Sequence[type]) -> Schema:
    """Return the JSON schema of a mapping whose keys belong to several dataclasses."""
    properties: dict[str, Schema] = {}
    required = []
    for section in sections:
        for wanted, needed in settings_of(section).values():
            properties[wanted.key] = wanted.spec.schema() | {"description": wanted.description}
            required += [wanted.key] if needed else []
    schema = {"type": "object", "properties": properties, "required": required, "additionalProperties": False}
    described = (sections[-1].__doc__ or "").split("\n\n")[0].strip()
    generated = described.startswith(f"{sections[-1].__name__}(")
    return schema | ({"description": described} if described and not generated else {})
