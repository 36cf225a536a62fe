"""How well the places in a list are known: the columns of standard deviations, and how they are read."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.errors import InputError
from metrocli.table import Column, Table

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
