"""Repeated calibrations of one thing: drift, pooled standard deviation, and E_n against the first."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.uncertainty.comparison import Measured, compare, quantities
from metrocli.uncertainty.numbers import factor


@dataclass(frozen=True)
class Drift:
    """The drift of one quantity over the calibrations."""

    group: str
    name: str
    rate: float
    """Slope of a straight line by least squares, weighted by the stated uncertainties; unit of the quantity per time"""
    std: float
    """Standard uncertainty of the rate, from the stated uncertainties and what they are known with as weights"""
    unit: str
    expanded: float
    """U of the rate, with the t factor of the calibrations"""

    @property
    def en(self) -> float:
        """`|rate| / U`; 0 for no drift, inf for one of quantities without uncertainty."""
        if self.rate == 0.0:
            return 0.0
        return abs(self.rate) / self.expanded if self.expanded > 0 else float("inf")


@dataclass(frozen=True)
class Pooled:
    """The scatter of all quantities of one group and unit about their means."""

    group: str
    unit: str
    std: float
    """`sqrt(sum (x_ij - mean_i)^2 / (q (n - 1)))` over q quantities in n calibrations"""
    expected: float
    """Root mean square of the stated standard uncertainties: what the scatter is if nothing but them is there"""
    dof: int
    """q (n - 1); entries of tables are correlated, so it is an upper bound of the degrees of freedom"""


@dataclass(frozen=True)
class RepeatedCalibrations:
    """What repeated calibrations show."""

    drifts: tuple[Drift, ...]
    pooled: tuple[Pooled, ...]
    against_first: tuple[float, ...]
    """Largest E_n of each later calibration against the first"""

    @property
    def max_en(self) -> float:
        """Largest E_n of all calibrations against the first."""
        return max(self.against_first)

    @property
    def max_drift_en(self) -> float:
        """Largest E_n of a drift."""
        return max((drift.en for drift in self.drifts), default=0.0)


def repeated(results: Sequence[Result], times: Sequence[float]) -> RepeatedCalibrations:
    """Return drift and scatter of what all results determine; times are in any unit, or numbers of the calibrations.

    Raises InputError for results of two kinds or without a common quantity, and for times that do not differ.
    """
    at = np.asarray(times, dtype=float)
    if not np.ptp(at) > 0:
        raise InputError("the calibrations have one time: a drift needs two times at least")
    against_first = tuple(compare(results[0], other).max_en for other in results[1:])
    each = [quantities(result) for result in results]
    names = [name for name in each[0] if all(name in values for values in each)]
    if not names:
        raise InputError("no estimate, table or point is in all of the results: a drift needs the same name in each")
    drifts: list[Drift] = []
    groups: dict[tuple[str, str], list[list[Measured]]] = {}
    for name in names:
        rows = [values[name] for values in each]
        if any(row.std > 0 for row in rows) or np.ptp([row.value for row in rows]) > 0:
            drifts.append(_drift(name, rows, at))
            groups.setdefault((name[0], rows[0].unit), []).append(rows)
    return RepeatedCalibrations(
        tuple(drifts), tuple(_pooled(group, unit, rows) for (group, unit), rows in groups.items()), against_first
    )


def _drift(name: tuple[str, str], rows: Sequence[Measured], at: Array) -> Drift:
    values, std = np.array([row.value for row in rows]), np.array([row.std for row in rows])
    dof = np.array([row.dof for row in rows])
    # without a weight for all of them each counts alike
    weighted = bool((std > 0).all())
    weights = 1 / std**2 if weighted else np.ones(len(std))
    moved = at - np.average(at, weights=weights)
    gradient = weights * moved / (weights * moved**2).sum()
    parts = gradient**2 * std**2
    variance = float(parts.sum())
    # weights from estimated noise favour values that look better than they are (Kackar and Harville 1984): they add as
    # much to the variance of the slope as they take from its estimate
    rest = 1 - weights / weights.sum() - gradient * moved
    flattered = 4 * float((parts * rest / dof).sum()) if weighted else 0.0
    # Welch-Satterthwaite over the calibrations (GUM G.4.1)
    doubt = float((parts**2 / dof).sum())
    k = float(factor(1, variance**2 / doubt if doubt > 0 else np.inf))
    spread = float(np.sqrt(variance + flattered))
    # differences from the first: a slope of 1e-9 beside a value of 1e3 would lose its digits
    return Drift(*name, float(gradient @ (values - values[0])), spread, rows[0].unit, k * spread)


def _pooled(group: str, unit: str, rows: Sequence[Sequence[Measured]]) -> Pooled:
    values = np.array([[quantity.value - row[0].value for quantity in row] for row in rows])
    std = np.array([[quantity.std for quantity in row] for row in rows])
    dof = values.shape[0] * (values.shape[1] - 1)
    scatter = ((values - values.mean(axis=1, keepdims=True)) ** 2).sum() / dof
    return Pooled(group, unit, float(np.sqrt(scatter)), float(np.sqrt((std**2).mean())), dof)
