"""Two results compared: differences by name, their uncertainty, E_n, and one test of all together."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli.adjust.probabilities import chi_square_tail
from metrocli.arrays import Array, Index
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.result import Result
from metrocli.uncertainty.numbers import factor

SHARED, OWED = "shared", "owed_to_"
"""Table of the inputs of a result that have a covariance, and arrays of what its estimates owe to each (m, k)"""
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
    expanded: float
    """`sqrt(U_A^2 + U_B^2 - 2 k_A k_B u(A, B))` (ISO/IEC 17043), u(A, B) what inputs of both make common

    k of each result is 2, or the t factor where its noise is estimated.
    """

    @property
    def en(self) -> float:
        """`|difference| / U`; 0 for no difference, inf for one of quantities without uncertainty."""
        if self.difference == 0.0:
            return 0.0
        return abs(self.difference) / self.expanded if self.expanded > 0 else float("inf")


@dataclass(frozen=True)
class Comparison:
    """All quantities that two results have in common."""

    compared: tuple[Compared, ...]
    chi2: float
    dof: int
    noise_dof: float
    """Degrees of freedom of the uncertainties; inf where both noises are declared"""
    only_in_one: tuple[str, ...]
    """Names that one result has and the other does not determine"""
    counted_once: tuple[str, ...] = ()
    """Inputs that both results are made from, whose errors are in the covariance of both estimates"""

    @property
    def p_value(self) -> float:
        """Probability of a chi2 at least as large, if the results differ only by their uncertainty.

        With estimated noise chi2 / dof has an F distribution (Hotelling), to the degree that one factor scales both.
        """
        if not self.dof or np.isinf(self.noise_dof):
            return chi_square_tail(self.dof, self.chi2) if self.dof else float("nan")
        from scipy.special import fdtrc

        return float(fdtrc(self.dof, self.noise_dof, self.chi2 / self.dof))

    @property
    def max_en(self) -> float:
        """Largest E_n."""
        return max((quantity.en for quantity in self.compared), default=0.0)


@dataclass(frozen=True)
class Measured:
    """One quantity of a result."""

    value: float
    std: float
    unit: str
    dof: float


@dataclass(frozen=True)
class _Values:
    """Quantities of a result with their joint covariance."""

    names: tuple[tuple[str, str], ...]
    """Group and name of each"""
    values: Array
    covariance: Array
    units: tuple[str, ...]
    dof: Array
    """Degrees of freedom of each"""

    @property
    def std(self) -> Array:
        """Standard uncertainties."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))


def quantities(result: Result) -> dict[tuple[str, str], Measured]:
    """Return all that a result can be compared in, by group and name: table entries, estimates, coordinates."""
    own = _of(result)
    rows = zip(own.values.tolist(), own.std.tolist(), own.units, own.dof.tolist(), strict=True)
    return {**dict(zip(own.names, (Measured(*row) for row in rows), strict=True)), **_coordinates(result)}


def compare(first: Result, second: Result) -> Comparison:
    """Return the differences `second - first` and the test of all with a covariance.

    `chi2 = d' (Q1 + Q2 - C - C')^+ d` over estimates and error tables, with as many degrees of freedom as the matrix
    has rank. C is the covariance of both by inputs that they share, as far as they have its factors; else they count
    as independent. Coordinates of points are compared one by one, as independent. Raises InputError for results of two
    kinds or with nothing in common.
    """
    if first.kind != second.kind:
        raise InputError(f"results of two kinds cannot be compared: {first.kind} and {second.kind}")
    values, other = _of(first), _of(second)
    others = set(other.names)
    common = [name for name in values.names if name in others]
    rows, columns = _rows(values, common), _rows(other, common)
    difference = other.values[columns] - values.values[rows]
    counted, joint = _by_shared(first, second, common)
    covariance = values.covariance[np.ix_(rows, rows)] + other.covariance[np.ix_(columns, columns)] - joint - joint.T
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    parts = [(values.std[rows], values.dof[rows]), (other.std[columns], other.dof[columns])]
    k = [factor(1, dof) for _, dof in parts]
    each = [wide * spread for wide, (spread, _) in zip(k, parts, strict=True)]
    expanded = np.sqrt(np.maximum(each[0] ** 2 + each[1] ** 2 - 2 * k[0] * k[1] * np.diag(joint), 0.0))
    # entries that the gauge holds at zero have neither a difference nor an uncertainty
    alive = np.flatnonzero((std > 0) | (difference != 0))
    compared = [
        Compared(*common[i], float(difference[i]), float(std[i]), values.units[rows[i]], float(expanded[i]))
        for i in alive.tolist()
    ]
    points = _coordinates(first), _coordinates(second)
    # one by one and as independent: results keep no covariance of two points
    compared += list(_points(*points))
    if not common and not compared:
        raise InputError("the results have nothing in common: no estimate, table or point of the same name")
    moving = alive[std[alive] > 0]
    chi2, dof = _tested(difference[moving], covariance[np.ix_(moving, moving)])
    apart = {" ".join(name).strip() for name in set(values.names) ^ set(other.names)}
    apart |= {f"{group} {name.rpartition('.')[0]}" for group, name in set(points[0]) ^ set(points[1])}
    return Comparison(tuple(compared), chi2, dof, _joint_dof(parts, moving), tuple(sorted(apart)), counted)


def _by_shared(first: Result, second: Result, common: list[tuple[str, str]]) -> tuple[tuple[str, ...], Array]:
    """Return the inputs that both results have with the same digest, and the covariance that they give (n, n).

    Rows are the common quantities of the first result, columns those of the second.
    """
    joint, names = np.zeros((len(common), len(common))), []
    if SHARED in first.tables and SHARED in second.tables:
        known = _digests(second)
        for digest, name in _digests(first).items():
            if digest in known:
                names.append(name)
                joint += _owed(first, name, common) @ _owed(second, known[digest], common).T
    return tuple(names), joint


def _digests(result: Result) -> dict[str, str]:
    table = result.tables[SHARED]
    return dict(zip(table.texts("digest"), table.texts("input"), strict=True))


def _owed(result: Result, name: str, common: list[tuple[str, str]]) -> Array:
    """Return what the common quantities of a result owe to an input (n, k); nothing but estimates does."""
    place = {("estimates", estimate.name): i for i, estimate in enumerate(result.estimates)}
    factors = np.asarray(result.arrays[OWED + name])
    nothing = np.zeros(factors.shape[1])
    return np.array([factors[place[key]] if key in place else nothing for key in common]).reshape(-1, len(nothing))


def _joint_dof(parts: list[tuple[Array, Array]], rows: Index) -> float:
    """Return the degrees of freedom of the sum of two covariances (Welch-Satterthwaite), by their mean shares."""
    if not len(rows):
        return float("inf")
    variances = [spread[rows] ** 2 for spread, _ in parts]
    shares = [float(np.mean(own / (variances[0] + variances[1]))) for own in variances]
    doubt = sum(share**2 / float(dof[rows].min()) for share, (_, dof) in zip(shares, parts, strict=True))
    return 1 / doubt if doubt > 0 else float("inf")


def _rows(values: _Values, names: list[tuple[str, str]]) -> Index:
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
    estimates = [i for i, estimate in enumerate(result.estimates) if ("estimates", estimate.name) not in names]
    called = _called(result)
    names += [("estimates", called.get(result.estimates[i].name, result.estimates[i].name)) for i in estimates]
    values += [result.estimates[i].value for i in estimates]
    units += [result.estimates[i].unit for i in estimates]
    blocks.append(np.asarray(result.covariance)[np.ix_(estimates, estimates)])
    size = sum(len(block) for block in blocks)
    joint, at = np.zeros((size, size)), 0
    for block in blocks:
        joint[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    stated = {estimate.name for estimate in result.estimates}
    dof = [result.degrees_of_freedom(name if group == "estimates" and name in stated else "") for group, name in names]
    return _Values(tuple(names), np.array(values), joint, tuple(units), np.array(dof, dtype=float))


def _called(result: Result) -> dict[str, str]:
    """Return names of the errors of a machine that have a value only together with others that are held at zero.

    Such a squareness holds for the tool vectors of its measurement. It is another quantity than the squareness alone.
    """
    if ENTRIES not in result.tables:
        return {}
    errors, tools = result.tables["errors"], result.tables["tools"]
    vectors = tools.stacked(("x", "y", "z"))[np.asarray(tools.columns["measured"], dtype=bool)]
    measured = " ".join(f"({x:.0f}, {y:.0f}, {z:.0f}) mm" for x, y, z in vectors + 0.0)
    rows = zip(*(errors.texts(column) for column in ("error", "status", "with")), strict=True)
    return {
        name: f"{name} with {others} of the tool {measured}" for name, status, others in rows if status == "together"
    }


def _entries(result: Result) -> tuple[list[tuple[str, str]], list[float], list[str], Array]:
    """Return the entries of error tables; those of a table that is not determined are left out."""
    listed, square = result.tables[ENTRIES], {estimate.name: estimate for estimate in result.estimates}
    names: list[tuple[str, str]] = []
    values, units, rows = [], [], []
    known = dict(zip(result.tables["errors"].texts("error"), result.tables["errors"].texts("status"), strict=True))
    # rotary axes have angles in a column of their own
    angles = listed.numbers("angle", float("nan"))
    places = np.where(np.isnan(angles), listed.numbers("position"), angles)
    for i, (error, position) in enumerate(zip(listed.texts("error"), places, strict=True)):
        if known.get(error) != "determined":
            continue
        if np.isnan(position):
            names.append(("estimates", error))
            values.append(square[error].value)
            units.append(square[error].unit)
        else:
            table = result.tables[TABLES + error]
            at = int(np.argmin(np.abs(table.numbers("position") - position)))
            turned = table.units["position"] == "rad"
            names.append((error, f"{np.degrees(position):g} deg" if turned else f"{position:g} mm"))
            values.append(float(table.numbers("value")[at]))
            units.append(table.units["value"])
        rows.append(i)
    return names, values, units, np.asarray(result.arrays[TABLES_COVARIANCE])[np.ix_(rows, rows)]


def _coordinates(result: Result) -> dict[tuple[str, str], Measured]:
    """Return the coordinates of the points of a result, by `points` and point and axis."""
    table = result.tables.get(POINTS)
    if table is None or not {"point", "x", "y", "z", "sx"} <= set(table):
        return {}
    dof = result.degrees_of_freedom()
    coordinates: dict[tuple[str, str], Measured] = {}
    for axis in "xyz":
        rows = zip(table.texts("point"), table.numbers(axis).tolist(), table.numbers(f"s{axis}").tolist(), strict=True)
        coordinates |= {(POINTS, f"{name}.{axis}"): Measured(value, std, "mm", dof) for name, value, std in rows}
    return coordinates


def _points(first: dict[tuple[str, str], Measured], second: dict[tuple[str, str], Measured]) -> Iterator[Compared]:
    common = [name for name in first if name in second]
    parts = [[values[name] for name in common] for values in (first, second)]
    std = [np.array([quantity.std for quantity in part]) for part in parts]
    k = [factor(1, np.array([quantity.dof for quantity in part])) for part in parts]
    expanded = np.hypot(k[0] * std[0], k[1] * std[1])
    rows = zip(common, *parts, np.hypot(std[0], std[1]).tolist(), expanded.tolist(), strict=True)
    for (group, name), row, other, spread, large in rows:
        yield Compared(group, name, other.value - row.value, spread, row.unit, large)


def _tested(difference: Array, covariance: Array) -> tuple[float, int]:
    """Return chi2 and its degrees of freedom; combinations without an uncertainty are left out."""
    if not len(difference):
        return 0.0, 0
    size = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / size[:, None] / size)
    # a correlation matrix, so that one bound serves quantities of all units
    good = values > _ROUNDING * values[-1]
    scores = (vectors.T @ (difference / size))[good] / np.sqrt(values[good])
    return float(scores @ scores), int(good.sum())
