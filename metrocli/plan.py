"""What `metrocli plan` gives: what a measurement will determine before it is made, and the files to make it with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from metrocli.result import Estimate, ShownTable
from metrocli.table import Table


@dataclass(frozen=True)
class Plan:
    """A planned measurement and what it will be worth."""

    kind: str
    notes: tuple[str, ...]
    """Lines of plain text: what it will determine, how well, what it will not see, and what would be better."""
    figures: tuple[Estimate, ...] = ()
    """Expected values (`std` 0 where they have none) and predicted standard uncertainties, in internal units."""
    tables: Mapping[str, Table] = field(default_factory=dict)
    """By name; each is written as NAME.csv."""
    files: Mapping[str, Table | str] = field(default_factory=dict)
    """Paths, poses and NC programs by file name: a table, to be written as CSV, or the text of the file."""
    warnings: tuple[str, ...] = ()
    shown: tuple[ShownTable, ...] = ()
