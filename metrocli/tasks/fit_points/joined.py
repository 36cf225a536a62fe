"""The result of several stations laid onto one another: their transformations, and all points in the common frame."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Mask
from metrocli.geometry import poses
from metrocli.result import SCALE as ABOUT_ONE
from metrocli.result import Estimate, Result, ShownTable
from metrocli.table import Table
from metrocli.tasks.fit_points import KIND
from metrocli.tasks.fit_points.effects import SCALE
from metrocli.tasks.fit_points.links import PLACE
from metrocli.tasks.fit_points.problem import POSE, Places, PointPairs
from metrocli.tasks.fit_points.report import notes, warnings
from metrocli.tasks.fit_points.tested import Tested, tested
from metrocli.tasks.shared.joint_covariance import factors
from metrocli.tasks.shared.rounding import without_rounding
from metrocli.tasks.shared.statistics import basic_statistics, with_noise
from metrocli.uncertainty.predicted import POINTS_COVARIANCE
from metrocli.words import listed


def joined(problem: PointPairs, solution: Solution) -> Result:
    """Return the result of several stations that are solved; estimates are named `S2.x`, `S2.scale`."""
    test, places = tested(problem, solution), problem.joins
    assert places is not None  # those of several stations are unknowns
    deviations = without_rounding(_deviations(problem, places, test), test.rounding)
    distance = np.sqrt((deviations**2).sum(axis=1))
    counts = np.bincount(places.of, minlength=len(places.names))
    # places that a single station measured, and no list has
    single = (counts == 1) & ~np.isfinite(places.spread.sigma).all(axis=1) & places.free.any(axis=1)
    rms = float(np.sqrt((distance[~single[places.of]] ** 2).mean()))
    statistics = basic_statistics(solution, {"mm": rms}) | {"points": len(places.names)}
    if problem.estimated:
        statistics = with_noise(statistics, solution, {"noise": test.factor * problem.start_noise})
    estimates, covariance = _estimates(problem, test)
    known = test.solution.covariance_or_raise()
    # without noise all covariances are zero, and have no factors
    shared = factors(known, PLACE, np.ones(len(counts), dtype=bool)) if test.factor else {}
    return Result(
        kind=KIND.name,
        title="",
        estimates=estimates,
        covariance=covariance,
        statistics=statistics,
        tables={
            "points": _points(test, places, counts),
            "deviations": Table.of(
                {
                    **{f"{key} [text]": names for key, names in problem.keys.items()},
                    "dx dy dz [mm]": deviations,
                    "d [mm]": distance,
                }
            ),
            "residuals": test.residuals,
            "suspects": test.suspects(problem.keys_with_places),
        },
        arrays={POINTS_COVARIANCE: known.members(PLACE), **shared},
        warnings=tuple(warnings(problem, test)),
        shown=(ShownTable("points"),),
        notes=(*notes(problem, test, rms), *_uncontrolled(places, single)),
    )


def _deviations(problem: PointPairs, places: Places, test: Tested) -> Array:
    """Return each measured point after the transformation of its station, less its place, (n, 3)."""
    blocks, at = test.solution.blocks, problem.station
    scale = 1.0 + blocks[SCALE].values[at]
    return poses.apply(blocks[POSE].values[at], scale * problem.measured) - blocks[PLACE].values[places.of]


def _points(test: Tested, places: Places, counts: Index) -> Table:
    """Return the points in the common frame, with the number of stations that measured each."""
    return Table.of(
        {
            "point": places.names,
            "x y z [mm]": without_rounding(test.solution.blocks[PLACE].values, test.rounding),
            "sx sy sz [mm]": test.solution.std(PLACE),
            "stations": counts,
        }
    )


def _estimates(problem: PointPairs, test: Tested) -> tuple[tuple[Estimate, ...], Array]:
    """Return position, angles and scale of each station that is not the frame, with their covariance.

    `P F Q F' P'` with Q that of the steps, F the derivatives of the estimates by them, and P the order by stations.
    """
    blocks = test.solution.blocks
    rows = np.flatnonzero(blocks[POSE].free[:, 0])
    scaled = (SCALE,) if problem.scale else ()
    covariance, count = test.solution.joint((POSE, *scaled)), len(rows)
    change = np.eye(len(covariance))
    for i, row in enumerate(rows):
        change[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] = poses.euler_form_by_step(blocks[POSE].values[row])
    # from all poses, then all scales, to all numbers of a station together
    order = np.concatenate(
        [np.arange(6 * count).reshape(count, 6), *([6 * count + np.arange(count)[:, None]] if scaled else [])], axis=1
    ).ravel()
    covariance = (change @ covariance @ change.T)[np.ix_(order, order)]
    values = poses.euler_form(blocks[POSE].values[rows])
    shifts = without_rounding(values[:, :3], test.rounding)
    ratios = np.concatenate([values[:, 3:], *([1.0 + blocks[SCALE].values[rows]] if scaled else [])], axis=1)
    every = np.concatenate([shifts, without_rounding(ratios, test.rounding / problem.extent)], axis=1)
    units = [("mm", "")] * 3 + [("rad", "")] * 3 + [("1", ABOUT_ONE)] * len(scaled)
    names = [
        (f"{problem.stations[row]}.{name}", unit)
        for row in rows
        for name, unit in zip((*poses.EULER, *scaled), units, strict=True)
    ]
    numbers = zip(names, every.ravel().tolist(), np.sqrt(np.diag(covariance)).tolist(), strict=True)
    return tuple(Estimate(name, value, std, *unit) for (name, unit), value, std in numbers), covariance


def _uncontrolled(places: Places, single: Mask) -> list[str]:
    """Return a note on the points of a single station, if there are any."""
    names = [places.names[i] for i in np.flatnonzero(single)]
    text = "measured by one station only, so nothing controls them, and the root mean square is without them"
    return [f"{text}: {listed(names)}"] if names else []
