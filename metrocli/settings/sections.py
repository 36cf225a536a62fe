"""Sections of a job file: mappings with known keys, read into frozen dataclasses; all faults are collected."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import cache
from typing import Any

from metrocli.errors import Fault
from metrocli.frozen import dataclass
from metrocli.nodes import Node
from metrocli.settings.values import BAD, Schema, Spec, refuse
from metrocli.table import MOST_FAULTS
from metrocli.words import suggestion


@dataclass(frozen=True)
class Setting:
    """One key of a job file, as described in the metadata of a dataclass field."""

    spec: Spec
    description: str
    key: str


def setting(spec: Spec, description: str, default: Any = dataclasses.MISSING, key: str = "") -> Any:
    """Return the dataclass field of one key of a job file; the key is required if it has no default.

    `key` gives its name in the file if it differs from the field, such as a word that Python reserves.
    """
    metadata = {"setting": (spec, description, key)}
    if isinstance(default, Mapping | list):
        return field(default_factory=lambda: default, metadata=metadata)
    return field(default=default, metadata=metadata)


def content(spec: Any, description: str = "", needed: bool = True, default: Any = dataclasses.MISSING) -> Any:
    """Return the field of a dataclass that holds the contents of a job's files, from which `inputs_of` makes the keys.

    `needed`: the job has to name the file. Without it the content is `default`, and None for other files.
    """
    absent = default if needed else None
    return field(default=absent, metadata={"content": (spec, description or spec.columns.description, needed)})


def inputs_of(files: type) -> Any:
    """Return the section `inputs:` of a job: paths, under the names of the fields that hold their contents."""
    given = [(entry.name, *entry.metadata["content"]) for entry in dataclasses.fields(files)]
    keys = [
        (name, Any, setting(spec, text) if needed else setting(spec, text, default=None))
        for name, spec, text, needed in sorted(given, key=lambda entry: not entry[3])
    ]
    made = dataclasses.make_dataclass("Inputs", keys, frozen=True)
    made.__doc__ = files.__doc__
    return made


def settings_of(section: type) -> Mapping[str, tuple[Setting, bool]]:
    """Return for each field name of a dataclass its setting, and whether it is required."""
    return _settings_of(section)


@cache
def _settings_of(section: type) -> Mapping[str, tuple[Setting, bool]]:
    values = {}
    for item in dataclasses.fields(section):
        spec, description, key = item.metadata["setting"]
        required = item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING
        values[item.name] = (Setting(spec, description, key or item.name), required)
    return values


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
    """Read one mapping into several dataclasses, each with its own keys; the value is BAD for each with a fault.

    The mapping ELSEWHERE of a class has keys that belong to other jobs, and what to write instead.
    """
    if node.kind != "mapping":
        return [refuse(Section(section), node, faults) for section in sections]
    known = [wanted.key for section in sections for wanted, _ in settings_of(section).values()]
    place = f" in '{node.path}'" if node.path else ""
    reasons = {key: why for section in sections for key, why in getattr(section, "ELSEWHERE", {}).items()}
    unknown = [key for key, _ in node.entries if key.text not in known]
    for key in unknown[:MOST_FAULTS]:
        hint = reasons.get(key.text) or _below(key.text, sections) or _hint_for_key(key.text, known)
        faults.append(key.fault(f"unknown key '{key.text}'{place}", hint))
    if len(unknown) > MOST_FAULTS:
        faults.append(unknown[MOST_FAULTS].fault(f"and {len(unknown) - MOST_FAULTS} more unknown keys from here on"))
    return [_read_section(node, section, faults) for section in sections]


def _below(key: str, sections: Sequence[type]) -> str:
    """Return where a key belongs that one of the mappings below has, else nothing."""
    for wanted, _ in (one for section in sections for one in settings_of(section).values()):
        if isinstance(wanted.spec, Section) and key in (
            below.key for below, _ in settings_of(wanted.spec.section).values()
        ):
            return f"it is a key of '{wanted.key}': {wanted.key}.{key}"
    return ""


def _hint_for_key(key: str, known: Sequence[str]) -> str:
    """Return the nearest key, or an explanation if a comma in {...} split a value in two."""
    if re.fullmatch(r"[0-9]+\s*[^\W\d_]*", key):
        return "a comma ends a value here: write a decimal point, or put a value that contains a comma in quotes"
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
    """Add the faults that the section's method `faults` finds across its keys.

    The method yields `(key path, message[, hint])`, or a Fault with its place. Returns BAD if there is any.
    """
    check = getattr(value, "faults", None)
    message = list(check()) if check else []
    listed = [item if isinstance(item, Fault) else node.at(item[0]).fault(*item[1:]) for item in message]
    faults.extend(listed)
    return BAD if listed else value


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
