"""The result of a multilateration: points with their covariance, tracers, reliability, and the corrected probing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.errors import Fault, InputError
from metrocli.instruments import tracer as t
from metrocli.result import Estimate, Result
from metrocli.table import Table
from metrocli.tasks.adjustment_statistics import basic_statistics, noise_warnings
from metrocli.tasks.length_network import Network, Solved
from metrocli.tasks.sightings import listed

if TYPE_CHECKING:
    from metrocli.table import Values

KIND = "multilaterate"
_UNITS = ("mm", "mm", "mm", "mm", "1")
_DELTA0 = 4.13
"""Non-centrality of a w-test at 0.1 % with 80 % power (Baarda 1968): the least detectable bias is 4.13 s / sqrt(r)"""


def report(solved: Solved, probing: Table | None, tolerance: float) -> Result:
    """Return the result of a solved network."""
    solution = solved.solution
    found = residuals_of(solution, solved.group)
    names, values, covariance, units = _tracer_estimates(solution)
    std = np.sqrt(np.diag(covariance))
    points, point_covariance = _points(solved)
    tables = {
        "points": points,
        "residuals": _residuals(solved, found),
        "tracers": _tracers(solution),
        "rejected": _rejected(solved),
    }
    if probing is not None:
        tables["corrected"] = corrected(solved, probing, tolerance)
    rms = float(np.sqrt((found.values**2).mean()))
    return Result(
        kind=KIND,
        title="",
        estimates=tuple(Estimate(*row) for row in zip(names, values.tolist(), std.tolist(), units, strict=True)),
        covariance=covariance,
        statistics=basic_statistics(solution, {"mm": rms}) | {"rejected": len(solved.rejected)},
        tables=tables,
        arrays={"points_covariance": point_covariance},
        warnings=tuple(_warnings(solved)),
        shown=("points: point, x, y, z, sx, sy, sz",),
    )


def _tracer_estimates(solution: Solution) -> tuple[list[str], Array, Array, list[str]]:
    block = solution.blocks[t.TRACER]
    free = np.flatnonzero(block.free.ravel())
    names = [f"{member}.{column}" for member in block.members for column in block.columns]
    covariance = solution.known().of(t.TRACER)[np.ix_(free, free)]
    units = list(_UNITS) * len(block.members)
    return [names[i] for i in free], block.values.ravel()[free], covariance, [units[i] for i in free]


def _points(solved: Solved) -> tuple[Table, Array]:
    solution = solved.solution
    block = solution.blocks[t.POINT]
    seen = np.bincount(solved.group.observations.index[t.POINT], minlength=len(block.members)) > 0
    each = solution.known().members(t.POINT)[seen]
    std = np.sqrt(np.einsum("mii->mi", each))
    error = solved.network.nominal[seen] - block.values[seen]
    columns: dict[str, Values] = {"point": np.array(block.members)[seen]}
    columns |= {name: block.values[seen, i] for i, name in enumerate("xyz")}
    columns |= {f"s{name}": std[:, i] for i, name in enumerate("xyz")}
    columns |= {f"error_{name}": error[:, i] for i, name in enumerate("xyz")}
    return Table(columns, {name: "mm" for name in columns if name != "point"}), each


def _tracers(solution: Solution) -> Table:
    block = solution.blocks[t.TRACER]
    std = solution.std(t.TRACER)
    columns: dict[str, Values] = {"tracer": np.array(block.members)}
    for i, name in enumerate(block.columns):
        columns[name], columns[f"s_{name}"] = block.values[:, i], std[:, i]
    units = {f"{s}{name}": "mm" for name in ("x", "y", "z", "dead_path") for s in ("", "s_")}
    return Table(columns, units)


def _residuals(solved: Solved, found: Residuals) -> Table:
    """Return /residuals with the minimal detectable bias of each length and how far it could move its point unseen."""
    observations = solved.group.observations
    redundancy = found.redundancy[0]
    sure = np.maximum(redundancy, 1e-12)
    detectable = np.where(redundancy > 1e-6, _DELTA0 * found.sigma[0] / np.sqrt(sure), np.inf)
    columns: dict[str, Values] = {name: np.array(values) for name, values in observations.keys.items()}
    columns |= {
        "reading": observations.readings[0],
        "residual": found.values[0],
        "sigma": found.sigma[0],
        "normalised": found.normalised[0],
        "redundancy": redundancy,
        "detectable": detectable,
        "moves_point": _point_shift(solved) * detectable,
    }
    return Table(columns, dict.fromkeys(("reading", "residual", "sigma", "detectable", "moves_point"), "mm"))


def _point_shift(solved: Solved) -> Array:
    """Return how far a point moves for a unit error of one of its lengths, |Q_x. J' / sigma^2|, (n,)."""
    solution, group = solved.solution, solved.group
    cofactor = solution.cofactor
    if cofactor is None:
        raise RuntimeError(solution.outcome.value)
    touches = group.linear(solution.blocks, cofactor.layout.wanted).touches
    index = group.observations.index[t.POINT]
    shift = np.zeros((3, len(index)))
    for touch in touches:
        pair = cofactor.pairs(t.POINT, index, touch.block, touch.index)
        shift += np.einsum("abn,bn->an", pair, touch.jacobian[0])
    return np.asarray(np.linalg.norm(shift / group.observations.sigma[0], axis=0))


def _rejected(solved: Solved) -> Table:
    rows = [row for row, _ in solved.rejected]
    observations = solved.network.lengths.observations
    return Table(
        {
            **{key: np.array([values[i] for i in rows], dtype=str) for key, values in observations.keys.items()},
            "reading": observations.readings[0, rows],
            "w": np.array([test for _, test in solved.rejected], dtype=float),
        },
        {"reading": "mm"},
    )


def corrected(solved: Solved, probing: Table, tolerance: float) -> Table:
    """Return the probing points with the mover's error at their replayed points taken off, in the shape they came.

    A probing point belongs to the point of its name, else to the nearest nominal point within the tolerance. Raises
    InputError that lists every probing point without a replayed one.
    """
    block = solved.solution.blocks[t.POINT]
    seen = np.bincount(solved.group.observations.index[t.POINT], minlength=len(block.members)) > 0
    place = {name: i for i, name in enumerate(block.members) if seen[i]}
    at = probing.stacked("xyz")
    usable = np.flatnonzero(seen)
    match = np.array([place.get(name, -1) for name in probing.texts("point")], dtype=np.intp)
    for row in np.flatnonzero(match < 0):
        gap = np.linalg.norm(solved.network.nominal[usable] - at[row], axis=1)
        if gap.size and gap.min() <= tolerance:
            match[row] = usable[int(gap.argmin())]
    lost = np.flatnonzero(match < 0)
    if lost.size:
        names = probing.texts("point")
        raise InputError(
            [
                Fault(
                    f"probing point '{names[row]}' has no replayed point of its name or within {tolerance:g} mm",
                    probing.file,
                    probing.lines[row] if probing.lines else None,
                )
                for row in lost
            ]
        )
    moved = at + block.values[match] - solved.network.nominal[match]
    columns: dict[str, Values] = {name: probing.columns[name] for name in ("feature", "point")}
    columns |= {name: moved[:, i] for i, name in enumerate("xyz")}
    return Table(columns, dict.fromkeys("xyz", "mm"))


def _warnings(solved: Solved) -> list[str]:
    lines = [*solved.network.warnings, *noise_warnings(solved.solution)]
    keys = solved.group.observations.keys
    order = np.argsort(-solved.suspects.tests)
    worst = [
        f"{keys['point'][i]}/{keys['tracer'][i]} (w = {w:.1f})"
        for i, w in zip(solved.suspects.rows[order].tolist(), solved.suspects.tests[order].tolist(), strict=True)
    ]
    if worst:
        lines.append(
            f"{len(worst)} lengths exceed the outlier bound |w| = {solved.suspects.critical:.2f}: {listed(worst, 5)}; "
            "`outliers: remove` leaves such lengths out"
        )
    return lines


def explained(network: Network, solution: Solution) -> str:
    """Say what is undetermined, why, and what would determine it."""
    lines = [f"{solution.outcome.value}: {solution.observations} readings, {solution.unknowns} unknowns"]
    lines += [f"  undetermined: {combination}" for combination in solution.undetermined[:3]]
    lines += [f"  why: {reason}" for reason in _reasons(network)]
    return "\n".join(lines)


def _reasons(network: Network) -> list[str]:
    index = network.lengths.observations.index
    points, tracers = network.blocks[t.POINT], network.blocks[t.TRACER]
    reasons = []
    if len(tracers.members) < 4:
        reasons.append(f"there are {len(tracers.members)} tracers; positions from length changes need four or more")
    places = tracers.values[:, :3]
    if len(places) >= 4 and _thin(places):
        reasons.append("the tracers stand in one plane: points are known up to a mirror image and loosely across it")
    seen = np.unique(index[t.POINT])
    if _thin(points.values[seen]):
        reasons.append("the points lie in one plane")
    counts = np.bincount(index[t.POINT], minlength=len(points.members))
    few = [name for name, n in zip(points.members, counts, strict=True) if 0 < n < 3]
    if few:
        reasons.append(f"points seen by fewer than three tracers: {listed(few)}")
    return reasons or ["the layout carries too few independent lengths: add tracers or points away from the others"]


def _thin(points: Array) -> bool:
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(len(spread) < 3 or spread[2] < 1e-3 * spread[0])
