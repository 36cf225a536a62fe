"""Specifications of job files: they read nodes into frozen dataclasses and describe themselves as JSON schema.

`sections` reads a mapping by the fields of a dataclass, each field by its specification: `values` (one text), `files`
(a path), `composites` (lists, alternatives, a value with its std). Faults are collected, none is raised: a job with
five mistakes lists five. The same specifications give the schema, so both cannot differ.
"""

from metrocli.settings.composites import UNKNOWN, At, Either, KnownQuantity, ListOf, LocatedValue, MapOf, Uncertain
from metrocli.settings.files import (
    ANY_KIND,
    FileOf,
    ImageFiles,
    MeshFile,
    TableFile,
    folders_searched,
    has_wildcards,
    path_beside,
)
from metrocli.settings.sections import (
    Section,
    Setting,
    content,
    inputs_of,
    read_sections,
    sections_schema,
    setting,
    settings_of,
)
from metrocli.settings.values import BAD, Choice, Flag, Number, QuantityLimits, Schema, Spec, Text, Whole, WithUnit

__all__ = [
    "ANY_KIND",
    "BAD",
    "UNKNOWN",
    "At",
    "Choice",
    "Either",
    "FileOf",
    "Flag",
    "ImageFiles",
    "KnownQuantity",
    "ListOf",
    "LocatedValue",
    "MapOf",
    "MeshFile",
    "Number",
    "QuantityLimits",
    "Schema",
    "Section",
    "Setting",
    "Spec",
    "TableFile",
    "Text",
    "Uncertain",
    "Whole",
    "WithUnit",
    "content",
    "folders_searched",
    "has_wildcards",
    "inputs_of",
    "path_beside",
    "read_sections",
    "sections_schema",
    "setting",
    "settings_of",
]
