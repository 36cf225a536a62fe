"""Lists of places: the columns of standard deviations, how they are read, and how a list is made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.errors import InputError
from metrocli.table import Column, Table

if TYPE_CHECKING:
    from metrocli.table import Values

SIGMAS = tuple(
    Column(name, "length", required=False, may_be_empty=True) for name in ("sigma", "sigma_x", "sigma_y", "sigma_z")
)
"""Columns of standard deviations: one for all three coordinates, or one for each"""


def sigmas(table: Table, without: float = float("nan")) -> Array:
    """Return the standard deviations of places, (rows, 3) mm: 0 is exact, nan is unknown.

    A coordinate without a column has the value `without`. Raises InputError that names every row with a negative one.
    """
    common = table.numbers("sigma", without)
    sigma = np.stack([table.numbers(f"sigma_{axis}") if f"sigma_{axis}" in table else common for axis in "xyz"], axis=1)
    negative = np.flatnonzero((sigma < 0).any(axis=1))
    if negative.size:
        raise InputError(table.faults_at(negative, lambda row: "a standard deviation is negative"))
    return sigma


def listed_places(key: str, names: Sequence[str], places: Array) -> Table:
    """Return the table of named places (n, 3) mm, with the names in the column `key`."""
    columns: dict[str, Values] = {key: np.array(names)}
    columns |= {axis: places[:, i] for i, axis in enumerate("xyz")}
    return Table(columns, dict.fromkeys("xyz", "mm"))
