"""A planned measurement, as `metrocli plan` gives it: what it will determine, and the files to carry it out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

from metrocli.frozen import dataclass
from metrocli.result import Estimate, ShownTable
from metrocli.table import Table


@dataclass(frozen=True)
class Plan:
    """A planned measurement with its predicted uncertainties and its files."""

    kind: str
    notes: tuple[str, ...]
    """Lines of text: what it will determine and how well, what it will not detect, and what would be better."""
    figures: tuple[Estimate, ...] = ()
    """Expected values and predicted standard uncertainties in internal units; `std` is 0 for exact figures."""
    tables: Mapping[str, Table] = field(default_factory=dict)
    """Tables by name; each is written as NAME.csv."""
    files: Mapping[str, Table | str] = field(default_factory=dict)
    """Paths, poses and NC programs by file name: a table that is written as CSV, or the text of the file."""
    warnings: tuple[str, ...] = ()
    shown: tuple[ShownTable, ...] = ()
