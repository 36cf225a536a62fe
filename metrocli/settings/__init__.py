"""Specifications of job files: they read nodes into frozen dataclasses and describe themselves as JSON schema."""

from metrocli.settings.composites import UNKNOWN, At, Either, Known, ListOf, MapOf, Placed, Uncertain
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
from metrocli.settings.sections import Section, Setting, read_sections, sections_schema, setting, settings_of
from metrocli.settings.values import BAD, Choice, Flag, Limits, Number, Quantity, Schema, Spec, Text, Whole

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
    "Known",
    "Limits",
    "ListOf",
    "MapOf",
    "MeshFile",
    "Number",
    "Placed",
    "Quantity",
    "Schema",
    "Section",
    "Setting",
    "Spec",
    "TableFile",
    "Text",
    "Uncertain",
    "Whole",
    "folders_searched",
    "has_wildcards",
    "path_beside",
    "read_sections",
    "sections_schema",
    "setting",
    "settings_of",
]
