"""The result of a fit-part job: pose, overstock by point and surface, what holds it, and targets in the part frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from metrocli.geometry import poses
from metrocli.geometry.surfaces import Array
from metrocli.result import Estimate, Result, ShownTable
from metrocli.table import Table
from metrocli.tasks.fit_part import KIND
from metrocli.tasks.fit_part.contradiction import motions_without
from metrocli.tasks.fit_part.draws import DRAWS
from metrocli.tasks.fit_part.fit import MOST
from metrocli.tasks.fit_part.monte_carlo import Check
from metrocli.tasks.fit_part.solve import Solved
from metrocli.tasks.fit_part.uncertainty import of_result
from metrocli.words import in_a_row, listed

if TYPE_CHECKING:
    from metrocli.table import Values

_UNITS = ("mm", "mm", "mm", "rad", "rad", "rad")
_NO_CHANCE = 1e-9
"""Chance up to which a surface counts as clean: the tails of the errors are not known so far out"""
_ALIKE = 1e-7
"""Difference of overstock up to which points are equally low: more than `most` gives up [mm]"""
_DEPENDENT = 1e-6
"""Share of a direction of rows, relative to the largest, below which it is rounding"""
_LIKELY = 0.05
"""Chance of a surface that stays unclean from which a warning names it"""


def report(solved: Solved, check: Check | None = None) -> Result:
    """Return the result of a fitted part."""
    fit, names = solved.fit, solved.prepared.readings.surface_points.names
    change = of_result(fit)
    covariance = change @ solved.sensitivity.covariance @ change.T
    values = poses.euler_form(poses.inverse(fit.into)) + 0.0  # a part that stays has 0, not -0
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    overstock = _overstock(solved)
    surfaces = _surfaces(solved, overstock, _std_of_means(solved))
    holding = _holding(solved)
    targets, arrays = _targets(solved)
    tables = {
        "overstock": overstock,
        "surfaces": surfaces,
        "holding": holding,
        "rejected": _rejected(solved, names),
        "targets": targets,
        **({"monte_carlo": check.table} if check is not None else {}),
    }
    of_used = fit.local.overstock
    statistics = {
        "observations": len(of_used),
        "unknowns": 6,
        "dof": len(of_used) - 6,
        "iterations": fit.iterations,
        "minimum": solved.minimum,
        "least_overstock": float(of_used.min()),
        "mean_overstock": float(of_used.mean()),
        "largest_overstock": float(of_used.max()),
        "variation": float(of_used.std()),
        "largest_least_overstock": solved.largest,
        "optimality": fit.optimality,
        "active": int((fit.duals > 0).sum()),
        "rejected": len(tables["rejected"]),
        "targets": len(targets),
        **solved.prepared.readings.growth,
        **({} if check is None else check.statistics),
    }
    shown = [ShownTable("surfaces")] + ([ShownTable("rejected")] if len(tables["rejected"]) else [])
    return Result(
        kind=KIND.name,
        title="",
        estimates=tuple(
            Estimate(name, float(value), float(s), unit)
            for name, value, s, unit in zip(poses.EULER, values, std, _UNITS, strict=True)
        ),
        covariance=(covariance + covariance.T) / 2,
        statistics=statistics,
        tables=tables,
        arrays={**arrays, "rotation": poses.rotation_of(poses.inverse(fit.into))},
        warnings=(*solved.warnings, *_warnings(solved, surfaces, tables["rejected"])),
        shown=tuple(shown),
        notes=(*_notes(solved, holding), *(check.notes if check is not None else ())),
    )


def below(overstock: Array, std: Array, minimum: float) -> Array:
    """Return the chance that the true overstock is below the minimum, for normal errors; 0 or 1 without errors."""
    from scipy.special import ndtr

    gap = minimum - overstock
    exact = (gap > 1e-9).astype(float)
    return np.where(std > 0, ndtr(gap / np.where(std > 0, std, 1.0)), exact)


def _overstock(solved: Solved) -> Table:
    """Return /overstock: every surface point, with the uncertainty that its own measurement brings."""
    places, stock = solved.prepared.readings.surface_points, solved.levels.stock
    local = stock.at(solved.fit.into)
    outward = local.shape.normal @ poses.rotation_of(solved.fit.into)
    std = np.sqrt(np.einsum("na,nab,nb->n", outward, places.covariance, outward))
    columns: dict[str, Values] = {
        "point": np.array(places.names, dtype=str),
        "surface": np.array(stock.nominal.names, dtype=str)[stock.surface],
        "overstock": local.overstock,
        "s_overstock": std,
        "below": below(local.overstock, std, solved.minimum),
        "used": solved.used.astype(np.int64),
        **{axis: local.points[:, k] for k, axis in enumerate("xyz")},
    }
    return Table(columns, dict.fromkeys(("overstock", "s_overstock", "x", "y", "z"), "mm"))


def _std_of_means(solved: Solved) -> Array:
    """Return the standard uncertainty of the mean overstock of each surface that has points, in order [mm].

    Errors that points share, of scale say, do not average out.
    """
    places = solved.prepared.readings.surface_points.places
    outward = solved.levels.stock.at(solved.fit.into).shape.normal @ poses.rotation_of(solved.fit.into)
    used, (present, of_point) = solved.used, np.unique(solved.levels.stock.surface[solved.used], return_inverse=True)
    counts = np.bincount(of_point)
    own = np.einsum("na,nab,nb->n", outward, places.own, outward)[used]
    share = np.zeros((len(present), places.common.shape[2]))
    np.add.at(share, of_point, np.einsum("na,nak->nk", outward, places.common)[used])
    variance = np.bincount(of_point, own) + np.einsum("sk,kl,sl->s", share, places.core, share)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)) / counts)


def _surfaces(solved: Solved, overstock: Table, std_of_means: Array) -> Table:
    """Return /surfaces: least, mean and largest overstock, and the chance that a surface stays unclean."""
    of_point, value = solved.levels.stock.surface[solved.used], overstock.numbers("overstock")[solved.used]
    names, std = np.array(overstock.texts("point"))[solved.used], overstock.numbers("s_overstock")[solved.used]
    clean = np.log1p(-np.minimum(overstock.numbers("below")[solved.used], 1 - 1e-12))
    order = np.lexsort((value, of_point))
    present, first, counts = np.unique(of_point[order], return_index=True, return_counts=True)
    total = np.bincount(of_point, value)[present]
    chance = -np.expm1(np.bincount(of_point, clean)[present])
    columns: dict[str, Values] = {
        "surface": np.array(solved.stock.nominal.names, dtype=str)[present],
        "points": counts,
        "least": value[order][first],
        "s_least": std[order][first],
        "mean": total / counts,
        "s_mean": std_of_means,
        "largest": value[order][first + counts - 1],
        "least_at": names[order][first],
        "below": np.where(chance > _NO_CHANCE, chance, 0.0),
    }
    return Table(columns, dict.fromkeys(("least", "s_least", "mean", "s_mean", "largest"), "mm"))


def _holding(solved: Solved) -> Table:
    """Return /holding: the points at the minimum with their dual values, the strongest first."""
    duals = solved.fit.duals
    rows = np.flatnonzero(duals > 0)
    rows = rows[np.argsort(-duals[rows], kind="stable")]
    names = np.array(solved.prepared.readings.surface_points.names, dtype=str)[solved.used]
    return Table(
        {
            "point": names[rows],
            "surface": np.array(solved.stock.nominal.names, dtype=str)[solved.stock.surface[rows]],
            "dual": duals[rows],
            "share": duals[rows] / max(float(duals.sum()), 1e-300),
        }
    )


def _rejected(solved: Solved, names: tuple[str, ...]) -> Table:
    rows = np.flatnonzero(~solved.used)
    stock, off = solved.levels.stock, solved.levels.off
    value = stock.at(solved.fit.into).overstock
    return Table(
        {
            "point": np.array(names, dtype=str)[rows],
            "surface": np.array(stock.nominal.names, dtype=str)[stock.surface[rows]],
            "overstock": value[rows],
            "off": off[rows],
            "reason": np.where(off[rows] > 0, "flash", "chip").astype(str),
        },
        {"overstock": "mm", "off": "mm"},
    )


def _targets(solved: Solved) -> tuple[Table, dict[str, Array]]:
    """Return /targets in the part frame, the covariance of each, and what they have in common.

    The joint covariance of targets i and j is `own_i [i = j] + common_i common_j'` with common (m, 3, k): their own
    errors, those that they share with the surface points, and those of the pose.
    """
    from scipy.linalg import block_diag

    targets, fit, sense = solved.prepared.readings.targets, solved.fit, solved.sensitivity
    places, turn = targets.places, poses.rotation_of(fit.into)
    points = poses.apply(fit.into, places.values) if len(targets.names) else np.zeros((0, 3))
    own = turn @ places.own @ turn.T
    moves = fit.local.movement_of(points)
    shared = np.concatenate([turn @ places.common + moves @ sense.by_common, moves], axis=2)
    common = _factor(shared, block_diag(sense.core, sense.own))
    whole = own + common @ np.swapaxes(common, 1, 2)
    std = np.sqrt(np.einsum("nkk->nk", whole))
    columns: dict[str, Values] = {"target": np.array(targets.names, dtype=str)}
    columns |= {axis: points[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"sigma_{axis}": std[:, k] for k, axis in enumerate("xyz")}
    arrays = {"targets_covariance": whole, "targets_own": own, "targets_common": common}
    return Table(columns, {name: "mm" for name in columns if name != "target"}), arrays


def _factor(common: Array, core: Array) -> Array:
    """Return F (m, 3, r) with `F_i F_j' = C_i K C_j'` for C (m, 3, k), K (k, k); negative variances count as zero."""
    basis, rest = np.linalg.qr(common.reshape(-1, len(core)))
    eigenvalues, vectors = np.linalg.eigh(rest @ core @ rest.T)
    kept = eigenvalues > 1e-12 * eigenvalues.max(initial=0.0)
    factor = basis @ (vectors[:, kept] * np.sqrt(eigenvalues[kept]))
    return np.asarray(factor.reshape(*common.shape[:2], factor.shape[1]))


def _notes(solved: Solved, holding: Table) -> Iterator[str]:
    fit, minimum = solved.fit, solved.minimum
    least = float(fit.local.overstock.min())
    largest = f"at most {solved.largest:.3f} mm is possible" if np.isfinite(solved.largest) else "it has no upper limit"
    yield f"least overstock {least:.3f} mm, minimum {minimum:.3f} mm ({largest})"
    share = holding.numbers("share")
    each = [
        f"{surface} ({point}, {100 * part:.0f} %)"
        for surface, point, part in zip(holding.texts("surface"), holding.texts("point"), share, strict=True)
    ]
    lowest = fit.local.overstock < least + _ALIKE
    others = int((exchanged(solved, lowest | (fit.duals > 0)) & (fit.duals == 0)).sum())
    if each and others:
        more = "1 more is" if others == 1 else f"{others} more are"
        yield f"held by: {listed(each)}; {more} as low and can hold it as well, so shares are one choice"
    elif each:
        yield f"held by: {listed(each)}; without these points the aim '{solved.aim.name}' would be better met"
    else:
        yield "held by: no point; the best pose has more than the minimum everywhere"
    free = motions_without(solved.stock, fit.local, lowest) if solved.aim.name == MOST else []
    if free:
        yield f"motions that no point with the least overstock holds, so even overstock decides: {in_a_row(free)}"
    if solved.prepared.part is not None:
        yield solved.prepared.part.note
    if solved.sensitivity.drawn:
        yield (
            f"the covariance of the pose is that of {DRAWS} fits to points with drawn errors, since errors exchange "
            "the points that hold it"
        )


def exchanged(solved: Solved, low: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return which of the low points (n,) others can stand for: their rows depend on those of the others.

    A point that is as low by chance, such as one that ends a motion which no other holds, has a dual of 0 alone.
    """
    rows = solved.fit.local.rows[low]
    # with the aim `most` the sum of the shares is given, too
    balanced = np.c_[rows, np.ones(len(rows))] if solved.aim.name == MOST else rows
    directions, size, _ = np.linalg.svd(balanced, full_matrices=False)
    fixed = (directions[:, size > _DEPENDENT * size[0]] ** 2).sum(axis=1)
    found = np.zeros(len(low), dtype=bool)
    found[low] = fixed < 1 - _DEPENDENT
    return found


def _warnings(solved: Solved, surfaces: Table, rejected: Table) -> Iterator[str]:
    for reason, what in (("chip", "material is missing"), ("flash", "material stands out")):
        rows = [row for row, one in enumerate(rejected.texts("reason")) if one == reason]
        if rows:
            off = np.abs(rejected.numbers("off")[rows])
            names = [rejected.texts("point")[row] for row in rows]
            count = "1 point is" if len(rows) == 1 else f"{len(rows)} points are"
            yield (
                f"{count} left out as {reason}: {listed(names, 5)}; {what}, up to {off.max():.2f} mm from the level of "
                "the surface (table rejected); `outliers: report` keeps all points"
            )
    minimum, of_used = solved.minimum, solved.fit.local.overstock
    if minimum < 0:
        missing = int((of_used < 0).sum())
        yield (
            f"the minimum is negative: up to {-minimum:g} mm of material may be missing at a point; "
            f"it is at {missing} of {len(of_used)} points (overstock below 0)"
        )
    low = [
        f"{point} ({value:.2f} mm)"
        for point, value in zip(rejected.texts("point"), rejected.numbers("overstock"), strict=True)
        if value < minimum
    ]
    if low:
        yield f"points left out have less than the minimum overstock, the surface stays unclean there: {listed(low, 5)}"
    outlying = np.flatnonzero(solved.levels.outlying & solved.used)
    if outlying.size:
        names = [solved.prepared.readings.surface_points.names[row] for row in outlying]
        yield (
            f"points far from the level of their surface take part: {listed(names, 5)}; "
            "`outliers: remove` leaves them out"
        )
    unclean = [
        f"{name} ({100 * chance:.0f} %)"
        for name, chance in zip(surfaces.texts("surface"), surfaces.numbers("below"), strict=True)
        if chance > _LIKELY
    ]
    if unclean and solved.prepared.readings.surface_points.covariance.any():
        yield (
            f"chance that the overstock is below the minimum somewhere, by errors of measurement: {in_a_row(unclean)}; "
            "a larger minimum allows for them"
        )
