"""Two results held against each other: differences by name, their uncertainty, E_n, and one test of all together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from metrocli.adjust.probabilities import chi_square_tail
from metrocli.errors import InputError
from metrocli.result import Result

Array = npt.NDArray[np.float64]
_COVERAGE = 2.0
"""Expanded uncertainty over standard uncertainty in E_n (ISO/IEC 17043)"""
_ROUNDING = 1e-9
"""Eigenvalues of a correlation matrix below this are rounding: the results do not determine that combination"""
TABLES, POINTS, ENTRIES, TABLES_COVARIANCE = "tables/", "points", "tables_entries", "tables_covariance"


@dataclass(frozen=True)
class Compared:
    """One quantity in two results."""

    group: str
    """`estimates`, the name of an error table, or `points`"""
    name: str
    """Of the estimate; the position of an entry of a table; point and coordinate"""
    difference: float
    """Second minus first, in the unit of the quantity"""
    std: float
    unit: str

    @property
    def en(self) -> float:
        """`|difference| / U`, U = 2 std; 0 for no difference, inf for one of quantities without uncertainty."""
        if self.difference == 0.0:
            return 0.0
        return abs(self.difference) / (_COVERAGE * self.std) if self.std > 0 else float("inf")


@dataclass(frozen=True)
class Comparison:
    """All quantities that two results have in common."""

    compared: tuple[Compared, ...]
    chi2: float
    dof: int
    only_in_one: tuple[str, ...]
    """Names that one result has and the other does not determine"""

    @property
    def p_value(self) -> float:
        """Probability of a chi2 at least as large, if the results differ only by their uncertainty."""
        return chi_square_tail(self.dof, self.chi2) if self.dof else float("nan")

    @property
    def max_en(self) -> float:
        """Largest E_n."""
        return max((one.en for one in self.compared), default=float("nan"))


@dataclass(frozen=True)
class _Values:
    """Quantities of a result with their joint covariance."""

    names: tuple[tuple[str, str], ...]
    """Group and name of each"""
    values: Array
    covariance: Array
    units: tuple[str, ...]


def compare(first: Result, second: Result) -> Comparison:
    """Return the differences `second - first`, as of independent measurements, and the test of all with a covariance.

    `chi2 = d' (Q1 + Q2)^+ d` over estimates and error tables, with as many degrees of freedom as the matrix has rank;
    coordinates of points are compared one by one. Raises InputError for results of two kinds or with nothing in common.
    """
    if first.kind != second.kind:
        raise InputError(f"results of two kinds cannot be compared: {first.kind} and {second.kind}")
    one, other = _of(first), _of(second)
    common = [name for name in one.names if name in set(other.names)]
    rows, columns = _rows(one, common), _rows(other, common)
    difference = other.values[columns] - one.values[rows]
    covariance = one.covariance[np.ix_(rows, rows)] + other.covariance[np.ix_(columns, columns)]
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # entries that the gauge holds at zero have neither a difference nor an uncertainty
    alive = np.flatnonzero((std > 0) | (difference != 0))
    found = [Compared(*common[i], float(difference[i]), float(std[i]), one.units[rows[i]]) for i in alive.tolist()]
    found += list(_points(first, second))
    if not found:
        raise InputError("the results have nothing in common: no estimate, table or point of the same name")
    moving = alive[std[alive] > 0]
    chi2, dof = _tested(difference[moving], covariance[np.ix_(moving, moving)])
    apart = sorted({" ".join(name).strip() for name in set(one.names) ^ set(other.names)})
    return Comparison(tuple(found), chi2, dof, tuple(apart))


def _rows(values: _Values, names: list[tuple[str, str]]) -> npt.NDArray[np.intp]:
    place = {name: i for i, name in enumerate(values.names)}
    return np.array([place[name] for name in names], dtype=np.intp)


def _of(result: Result) -> _Values:
    """Return the entries of error tables if the result has them, and the estimates that are not among them."""
    names: list[tuple[str, str]] = []
    values: list[float] = []
    units: list[str] = []
    blocks: list[Array] = []
    if TABLES_COVARIANCE in result.arrays:
        names, values, units, covariance = _entries(result)
        blocks.append(covariance)
    estimates = [i for i, one in enumerate(result.estimates) if ("estimates", one.name) not in names]
    names += [("estimates", result.estimates[i].name) for i in estimates]
    values += [result.estimates[i].value for i in estimates]
    units += [result.estimates[i].unit for i in estimates]
    blocks.append(np.asarray(result.covariance)[np.ix_(estimates, estimates)])
    size = sum(len(block) for block in blocks)
    joint, at = np.zeros((size, size)), 0
    for block in blocks:
        joint[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return _Values(tuple(names), np.array(values), joint, tuple(units))


def _entries(result: Result) -> tuple[list[tuple[str, str]], list[float], list[str], Array]:
    """Return the entries of error tables; those of a table that is not determined are left out."""
    listed, square = result.tables[ENTRIES], {one.name: one for one in result.estimates}
    names: list[tuple[str, str]] = []
    values, units, rows = [], [], []
    known = dict(zip(result.tables["errors"].texts("error"), result.tables["errors"].texts("status"), strict=True))
    for i, (error, position) in enumerate(zip(listed.texts("error"), listed.numbers("position"), strict=True)):
        if known.get(error) != "determined":
            continue
        if np.isnan(position):
            names.append(("estimates", error))
            values.append(square[error].value)
            units.append("rad")
        else:
            table = result.tables[TABLES + error]
            at = int(np.argmin(np.abs(table.numbers("position") - position)))
            names.append((error, f"{position:g} mm"))
            values.append(float(table.numbers("value")[at]))
            units.append(table.units["value"])
        rows.append(i)
    return names, values, units, np.asarray(result.arrays[TABLES_COVARIANCE])[np.ix_(rows, rows)]


def _points(first: Result, second: Result) -> Iterator[Compared]:
    tables = [result.tables.get(POINTS) for result in (first, second)]
    if any(table is None or not {"point", "x", "y", "z", "sx"} <= set(table) for table in tables):
        return
    one, other = (table for table in tables if table is not None)
    place = {name: i for i, name in enumerate(other.texts("point"))}
    for i, name in enumerate(one.texts("point")):
        if name in place:
            j = place[name]
            for axis in "xyz":
                difference = other.numbers(axis)[j] - one.numbers(axis)[i]
                std = np.hypot(one.numbers(f"s{axis}")[i], other.numbers(f"s{axis}")[j])
                yield Compared(POINTS, f"{name}.{axis}", float(difference), float(std), "mm")


def _tested(difference: Array, covariance: Array) -> tuple[float, int]:
    """Return chi2 and its degrees of freedom; combinations without an uncertainty are left out."""
    if not len(difference):
        return 0.0, 0
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / size[:, None] / size)
    good = values > _ROUNDING * values[-1]
    scores = (vectors.T @ (difference / size))[good] / np.sqrt(values[good])
    return float(scores @ scores), int(good.sum())
