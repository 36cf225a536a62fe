"""What a job delivers: estimates with their covariance, statistics, tables; independent of any file format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from metrocli.record import InputFile
from metrocli.table import Table

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Array = npt.NDArray[np.float64]

Scalar = float | int | str | bool


@dataclass(frozen=True)
class Estimate:
    """One estimated parameter with its standard uncertainty, in an internal unit."""

    name: str
    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class ShownTable:
    """A table that the terminal shows after the estimates."""

    name: str
    columns: tuple[str, ...] = ()
    """Those that are shown; all of them unless given"""


@dataclass(frozen=True)
class Result:
    """The outcome of one job."""

    kind: str
    title: str
    estimates: tuple[Estimate, ...]
    covariance: Array
    """Of the estimates, (k, k), in their order and units."""
    statistics: Mapping[str, Scalar | Mapping[str, float]]
    """observations, unknowns, dof, sigma0, chi2, p_value, iterations, rms: {unit: value}, ..."""
    tables: Mapping[str, Table] = field(default_factory=dict)
    """By name: residuals, views, points, ... ; a name may hold a slash for a group."""
    arrays: Mapping[str, Array] = field(default_factory=dict)
    """By name: points_covariance, ..."""
    warnings: tuple[str, ...] = ()
    shown: tuple[ShownTable, ...] = ()
    notes: tuple[str, ...] = ()
    """Lines of plain text for the reader of the result, such as a rotation matrix or what was rejected."""
    details: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """More that is said of an estimate beside value, std and unit, by its name: U, k, ...; in the unit of the estimate
    but for the names in `plain`."""
    plain: tuple[str, ...] = ()
    """Details that are plain numbers."""
    made_from: tuple[InputFile, ...] = ()
    """Where a result is the input of another job: its own file, and the files that it was made from."""
