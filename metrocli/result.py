"""The result of a job: estimates with their covariance, statistics and tables, independent of any file format."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Any

from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.record import InputFile
from metrocli.table import Table
from metrocli.units import find_unit

Scalar = float | int | str | bool
SCALE = "scale"
"""Dimension of an estimate that is a factor about 1: reports also show its difference from 1"""
K = 2.0
"""Coverage factor of expanded uncertainties where the result states no other"""


@dataclass(frozen=True)
class Estimate:
    """One estimated parameter with its standard uncertainty, in an internal unit."""

    name: str
    value: float
    std: float
    unit: str
    dimension: str = ""
    """The dimension (`metrocli/units`) whose units reports may use instead; SCALE for a factor about 1; else empty"""


@dataclass(frozen=True)
class ShownTable:
    """A table that the terminal shows after the estimates."""

    name: str
    columns: tuple[str, ...] = ()
    """Columns to show; all if empty. One with a unit, such as "A [arcsec]", is shown in it"""

    def of(self, table: Table) -> Table:
        """Return the columns of a table that are shown; unknown ones are left out."""
        if not self.columns:
            return table
        columns, shown = {}, dict(table.units)
        for heading in self.columns:
            name, _, symbol = heading.removesuffix("]").partition(" [")
            if name in table:
                columns[name] = table.columns[name]
                if symbol:  # only angles are shown in another unit than that of the table
                    columns[name] = table.numbers(name) / find_unit(symbol, "angle").inside(1.0)
                    shown[name] = symbol
        return replace(table, columns=columns, units=shown)


@dataclass(frozen=True)
class Result:
    """The outcome of one job."""

    kind: str
    title: str
    estimates: tuple[Estimate, ...]
    covariance: Array
    """Covariance of the estimates, (k, k), in their order and units."""
    statistics: Mapping[str, Scalar | Mapping[str, float]]
    """Figures of the adjustment by name: observations, unknowns, dof, sigma0, chi2, p_value, iterations,
    rms ({unit: value}), ..."""
    tables: Mapping[str, Table] = field(default_factory=dict)
    """Tables by name: residuals, views, points, ...; a slash in a name makes a group in the result file."""
    arrays: Mapping[str, Array] = field(default_factory=dict)
    """Arrays by name: points_covariance, ..."""
    warnings: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    """What the kind's own checks found that forbids the use of the result, one sentence each."""
    shown: tuple[ShownTable, ...] = ()
    notes: tuple[str, ...] = ()
    """Lines of text that the terminal shows with the result, such as a rotation matrix or rejected readings."""
    details: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Further figures of an estimate, by its name: U, k, ...; in the unit of the estimate, except those in `plain`."""
    plain: tuple[str, ...] = ("dof",)
    """Names of details that are plain numbers without a unit."""
    list_offset: float = 0.0
    """Distance of places from where the files list them, relative to what is plausible; not written to the file."""
    made_from: tuple[InputFile, ...] = ()
    """For a result that is the input of another job: its own file, and the files it was made from."""

    def expanded(self, estimate: Estimate) -> tuple[float, float]:
        """Return the expanded uncertainty and its k: those that the result states, else two standard uncertainties."""
        details = self.details.get(estimate.name, {})
        if "U" in details:
            return float(details["U"]), float(details.get("k", K))
        return K * estimate.std, K

    def degrees_of_freedom(self, name: str = "") -> float:
        """Return the fewest degrees of freedom of an estimate, or of all; inf where noise is declared."""
        stated = [details.get("dof") for key, details in self.details.items() if name in ("", key)]
        known = [float(dof) for dof in stated if isinstance(dof, int | float) and math.isfinite(dof)]
        dof = self.statistics.get("dof")
        if not known and self.statistics.get("noise_estimated") and isinstance(dof, int | float) and dof > 0:
            return float(dof)
        return min(known, default=math.inf)
