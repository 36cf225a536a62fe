"""The result of a fit in a raw part, and the check of its uncertainties by fits to points with simulated errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli.arrays import Array, extents
from metrocli.errors import NotConvergedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.result import Estimate, Result, Scalar, ShownTable
from metrocli.table import Table
from metrocli.tasks.fit_part import KIND
from metrocli.tasks.fit_part.contradiction import feasible
from metrocli.tasks.fit_part.draws import drawing
from metrocli.tasks.fit_part.fit import EVEN, LEAST_MOTION, MOST, max_least_overstock_of_many
from metrocli.tasks.fit_part.sentences import MATERIAL, WRONG, notes, uncontrolled, warnings
from metrocli.tasks.fit_part.solve import FittedPart, fitted_part
from metrocli.tasks.fit_part.uncertainty import pose_by_step
from metrocli.tasks.shared.statistics import Statistics
from metrocli.tasks.shared.uncontrolled import TABLE, in_words

_UNITS = ("mm", "mm", "mm", "rad", "rad", "rad")
_NO_CHANCE = 1e-9
"""Chance up to which a surface counts as clean: the tails of the errors are not known so far out"""


def report(solved: FittedPart, check: Check | None = None) -> Result:
    """Return the result of a fitted part."""
    fit, names = solved.fit, solved.prepared.readings.surface_points.names
    change = pose_by_step(fit)
    covariance = change @ solved.sensitivity.covariance @ change.T
    values = poses.euler_form(poses.inverse(fit.to_part)) + 0.0  # a part that stays has 0, not -0
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    overstock = _overstock(solved)
    surfaces = _surfaces(solved, overstock, _std_of_means(solved))
    holding = _holding(solved)
    targets, arrays = _targets(solved)
    hidden = uncontrolled(solved)
    tables = {
        "overstock": overstock,
        "surfaces": surfaces,
        "holding": holding,
        "rejected": _rejected(solved, names),
        "targets": targets,
        TABLE: hidden,
        **({"monte_carlo": check.table} if check is not None else {}),
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
        statistics={**_statistics(solved), **({} if check is None else check.statistics)},
        tables=tables,
        arrays={**arrays, "rotation": poses.rotation_of(poses.inverse(fit.to_part))},
        warnings=(*solved.warnings, *warnings(solved, surfaces, tables["rejected"])),
        doubts=solved.doubts,
        shown=tuple(shown),
        notes=(*notes(solved, holding), *(check.notes if check is not None else ()), *in_words(hidden)),
    )


def _statistics(solved: FittedPart) -> Statistics:
    """Return numbers of points, and what the overstock is over those that are used [mm]."""
    fit, of_used = solved.fit, solved.fit.local.overstock
    return {
        **_freedom(solved),
        "iterations": fit.iterations,
        "minimum": solved.minimum,
        "least_overstock": float(of_used.min()),
        "mean_overstock": float(of_used.mean()),
        "largest_overstock": float(of_used.max()),
        "variation": float(of_used.std()),
        "largest_least_overstock": solved.largest,
        "optimality": fit.optimality,
        "active": int((fit.duals > 0).sum()),
        "rejected": int((~solved.used).sum()),
        "targets": len(solved.prepared.readings.targets.names),
        **solved.prepared.readings.growth,
    }


def _freedom(solved: FittedPart) -> Statistics:
    """Return numbers of points and unknowns: the pose and, unless motion is made small, the mean overstock.

    Degrees of freedom are those of least squares: of the even fit where no point holds it.
    """
    count, aim = len(solved.fit.local.overstock), solved.aim.name
    unknowns = 6 if aim == LEAST_MOTION else 7
    free = aim == EVEN and not (solved.fit.duals > 0).any()
    return {"observations": count, "unknowns": unknowns, **({"dof": count - unknowns} if free else {})}


def below(overstock: Array, std: Array, minimum: float) -> Array:
    """Return the chance that the true overstock is below the minimum, for normal errors; 0 or 1 without errors."""
    from scipy.special import ndtr

    gap = minimum - overstock
    exact = (gap > 1e-9).astype(float)
    return np.where(std > 0, ndtr(gap / np.where(std > 0, std, 1.0)), exact)


def _overstock(solved: FittedPart) -> Table:
    """Return /overstock: every surface point, with the uncertainty that its own measurement brings."""
    places, stock = solved.prepared.readings.surface_points, solved.levels.stock
    local = stock.at(solved.fit.to_part)
    outward = local.shape.normal @ poses.rotation_of(solved.fit.to_part)
    std = np.sqrt(np.einsum("na,nab,nb->n", outward, places.covariance, outward))
    return Table.of(
        {
            "point [text]": places.names,
            "surface": np.array(stock.nominal.names, dtype=str)[stock.surface],
            "overstock [mm]": local.overstock,
            "s_overstock [mm]": std,
            "below": below(local.overstock, std, solved.minimum),
            "used": solved.used.astype(np.int64),
            "x y z [mm]": local.points,
        }
    )


def _std_of_means(solved: FittedPart) -> Array:
    """Return the standard uncertainty of the mean overstock of each surface that has points, in order [mm].

    Errors that points share, of scale say, do not average out.
    """
    places = solved.prepared.readings.surface_points.places
    outward = solved.levels.stock.at(solved.fit.to_part).shape.normal @ poses.rotation_of(solved.fit.to_part)
    used, (present, of_point) = solved.used, np.unique(solved.levels.stock.surface[solved.used], return_inverse=True)
    counts = np.bincount(of_point)
    own = np.einsum("na,nab,nb->n", outward, places.own, outward)[used]
    share = np.zeros((len(present), places.common.shape[2]))
    np.add.at(share, of_point, np.einsum("na,nak->nk", outward, places.common)[used])
    variance = np.bincount(of_point, own) + np.einsum("sk,kl,sl->s", share, places.core, share)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)) / counts)


def _surfaces(solved: FittedPart, overstock: Table, std_of_means: Array) -> Table:
    """Return /surfaces: least, mean and largest overstock, and the chance that a surface stays unclean."""
    of_point, value = solved.levels.stock.surface[solved.used], overstock.numbers("overstock")[solved.used]
    names, std = np.array(overstock.texts("point"))[solved.used], overstock.numbers("s_overstock")[solved.used]
    clean = np.log1p(-np.minimum(overstock.numbers("below")[solved.used], 1 - 1e-12))
    order = np.lexsort((value, of_point))
    present, first, counts = np.unique(of_point[order], return_index=True, return_counts=True)
    total = np.bincount(of_point, value)[present]
    chance = -np.expm1(np.bincount(of_point, clean)[present])
    return Table.of(
        {
            "surface": np.array(solved.stock.nominal.names, dtype=str)[present],
            "points": counts,
            "least [mm]": value[order][first],
            "s_least [mm]": std[order][first],
            "mean [mm]": total / counts,
            "s_mean [mm]": std_of_means,
            "largest [mm]": value[order][first + counts - 1],
            "least_at": names[order][first],
            "below": np.where(chance > _NO_CHANCE, chance, 0.0),
        }
    )


def _holding(solved: FittedPart) -> Table:
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


def _rejected(solved: FittedPart, names: tuple[str, ...]) -> Table:
    rows = np.flatnonzero(~solved.used)
    stock, deviation = solved.levels.stock, solved.levels.deviation
    value, off = stock.at(solved.fit.to_part).overstock, deviation[rows]
    of_material = np.abs(off) <= MATERIAL * extents(stock.measured[solved.used]).max()
    return Table(
        {
            "point": np.array(names, dtype=str)[rows],
            "surface": np.array(stock.nominal.names, dtype=str)[stock.surface[rows]],
            "overstock": value[rows],
            "off": off,
            "reason": np.where(of_material, np.where(off > 0, "flash", "chip"), WRONG).astype(str),
        },
        {"overstock": "mm", "off": "mm"},
    )


def _targets(solved: FittedPart) -> tuple[Table, dict[str, Array]]:
    """Return /targets in the part frame, the covariance of each, and what they have in common.

    The joint covariance of targets i and j is `own_i [i = j] + common_i common_j'` with common (m, 3, k): their own
    errors, those that they share with the surface points, and those of the pose.
    """
    from scipy.linalg import block_diag

    targets, fit, sense = solved.prepared.readings.targets, solved.fit, solved.sensitivity
    places, turn = targets.places, poses.rotation_of(fit.to_part)
    points = poses.apply(fit.to_part, places.values) if len(targets.names) else np.zeros((0, 3))
    own = turn @ places.own @ turn.T
    moves = fit.local.movement_of(points)
    shared = np.concatenate([turn @ places.common + moves @ sense.by_common, moves], axis=2)
    common = _factor(shared, block_diag(sense.core, sense.own))
    whole = own + common @ np.swapaxes(common, 1, 2)
    std = np.sqrt(np.einsum("nkk->nk", whole))
    table = Table.of({"target [text]": targets.names, "x y z [mm]": points, "sigma_x sigma_y sigma_z [mm]": std})
    arrays = {"targets_covariance": whole, "targets_own": own, "targets_common": common}
    return table, arrays


def _factor(common: Array, core: Array) -> Array:
    """Return F (m, 3, r) with `F_i F_j' = C_i K C_j'` for C (m, 3, k), K (k, k); negative variances count as zero."""
    basis, rest = np.linalg.qr(common.reshape(-1, len(core)))
    eigenvalues, vectors = np.linalg.eigh(rest @ core @ rest.T)
    kept = eigenvalues > 1e-12 * eigenvalues.max(initial=0.0)
    factor = basis @ (vectors[:, kept] * np.sqrt(eigenvalues[kept]))
    return np.asarray(factor.reshape(*common.shape[:2], factor.shape[1]))


_ALIKE, _BY_CHANCE = 0.2, 3.0
"""Relative difference of a standard uncertainty from that of the simulated fits from which a note warns

It is more where few fits leave more to chance: a standard deviation of n values is known to `1/sqrt(2(n - 1))`.
"""


@dataclass(frozen=True)
class Check:
    """Standard uncertainties of the pose, as computed and as simulated."""

    table: Table
    statistics: Mapping[str, Scalar]
    notes: tuple[str, ...]


def checked(solved: FittedPart, minimum: float, trials: int, seed: int) -> Check:
    """Fit the part to points with simulated errors, `trials` times, and compare how far the poses are off."""
    rng = np.random.default_rng(seed)
    draw = drawing(solved.prepared.readings.surface_points.of(solved.used).places)
    rows = []
    for _ in range(trials):
        stock = replace(solved.stock, measured=solved.stock.measured + draw(rng))
        highest = (solved.fit.to_part, np.inf, solved.fit.duals)
        if solved.aim.name == MOST:
            highest = max_least_overstock_of_many(stock, solved.fit.to_part)
            if not feasible(highest[1], minimum):
                continue
        try:
            _, fitted = fitted_part(stock, solved.aim.name, minimum, highest, solved.prepared.start)
        except NotConvergedError:
            continue
        rows.append(poses.difference(poses.inverse(fitted.to_part), poses.inverse(solved.fit.to_part)))
    by_angle = poses.euler_form_by_step(poses.inverse(solved.fit.to_part))
    steps = np.array(rows).reshape(-1, 6) @ by_angle.T
    change = pose_by_step(solved.fit)
    computed = np.sqrt(np.diag(change @ solved.sensitivity.covariance @ change.T))
    # about the fitted pose, as the stated uncertainties are: exchanges of the points that hold it also shift the mean
    simulated = np.sqrt((steps**2).mean(axis=0)) if len(steps) else np.full(6, np.nan)
    # a part that stays where it was has neither
    ratio = np.where((computed == 0) & (simulated == 0), 1.0, simulated / np.maximum(computed, 1e-300))
    table = Table(
        {
            "parameter": np.array(poses.EULER),
            "value": computed,
            "simulated": simulated,
            "ratio": ratio,
            "unit": np.array(["mm"] * 3 + ["rad"] * 3),
        }
    )
    by_chance = _BY_CHANCE / np.sqrt(2 * max(len(steps) - 1, 1))
    agree = bool((np.abs(ratio - 1) < max(_ALIKE, by_chance)).all())
    verdict = "agree with" if agree else "differ from"
    note = (
        f"Monte Carlo: {len(steps)} of {trials} fits to points with simulated errors; their scatter is "
        f"{ratio.min():.2f} to {ratio.max():.2f} of the standard uncertainties, which {verdict} it"
    )
    if not agree:
        note += ": other points hold the fit in part of them, so use the simulated values (table monte_carlo)"
    statistics: dict[str, Scalar] = {"monte_carlo_trials": len(steps), "monte_carlo_failed": trials - len(steps)}
    return Check(table, statistics, (note,))
