"""The result of a best fit: transformation, moved points with their uncertainty, deviations and their tests."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.effects.estimates import estimates as estimates_of_effects
from metrocli.effects.estimates import free_blocks
from metrocli.effects.estimates import tables as effect_results
from metrocli.effects.model import Added
from metrocli.geometry import poses
from metrocli.result import SCALE as ABOUT_ONE
from metrocli.result import Estimate, Result, ShownTable
from metrocli.table import Table
from metrocli.tasks.fit_points import KIND
from metrocli.tasks.fit_points.effects import SCALE
from metrocli.tasks.fit_points.features import FeaturePoints, FittedFeatures, fitted_features
from metrocli.tasks.fit_points.problem import POSE, PointPairs
from metrocli.tasks.fit_points.start import RIGID, turned
from metrocli.tasks.fit_points.tested import Tested, tested
from metrocli.tasks.shared.features.requested import RequestedFeature
from metrocli.tasks.shared.rounding import without_rounding
from metrocli.tasks.shared.statistics import basic_statistics, noise_notes, noise_warnings, with_noise
from metrocli.words import listed

_NOTABLE = 0.95
"""A mirror image is named that has so many times the deviations or fewer"""


def report(
    problem: PointPairs,
    solved: tuple[Solution, Sequence[Added]],
    mirrored: float,
    wanted: Sequence[RequestedFeature] = (),
) -> Result:
    """Return the result of a best fit that is solved, with effects in its model.

    `mirrored` is the root mean square deviation of the mirror image [mm].
    """
    added, test = solved[1], tested(problem, solved[0])
    solution, factor, rounding = test.solution, test.factor, test.rounding
    of_angles = rounding / problem.extent
    pose, scale = solution.blocks[POSE].values[0], 1.0 + float(solution.blocks[SCALE].values[0, 0])
    scaled = bool(solution.blocks[SCALE].free.any())
    covariance = solution.joint((POSE, *((SCALE,) if scaled else ()), *free_blocks(added)))
    own = RIGID + scaled
    # with effects, or with errors that points have in common, both are taken as independent: so they are not too small
    tied = not (added or problem.joint)
    moved, std = _moved(problem, (pose, scale), covariance[:own, :own], tied)
    moved = without_rounding(moved, rounding)
    laid = _laid_features(problem, wanted, (pose, scale), covariance[:own, :own], tied)
    off = without_rounding(moved - problem.nominal, rounding)
    change = np.eye(len(covariance))
    change[:6, :6] = poses.euler_form_by_step(pose)
    of_euler = change @ covariance @ change.T
    euler, stds = poses.euler_form(pose), np.sqrt(np.diag(of_euler)).tolist()
    parts = (without_rounding(euler[:3], rounding), without_rounding(np.append(euler[3:], scale), of_angles))
    values = np.concatenate(parts).tolist()
    rows = [*zip(poses.EULER, values, stds, ("mm",) * 3 + ("rad",) * 3, strict=False)]
    estimates = [Estimate(name, value, s, unit) for name, value, s, unit in rows]
    if scaled:
        estimates.append(Estimate("scale", values[6], stds[6], "1", ABOUT_ONE))
    estimates += estimates_of_effects(added, solution)
    distance = np.sqrt(np.nansum(off**2, axis=1))
    size = float(np.sqrt((distance**2).mean()))
    statistics = basic_statistics(solution, {"mm": size}) | {"points": len(problem.names), "mirrored_rms": mirrored}
    if problem.estimated:
        statistics = with_noise(statistics, solution, {"noise": factor * problem.start_noise})
    points = {
        "point": problem.names,
        "x y z [mm]": moved,
        "sx sy sz [mm]": std,
        "dx dy dz [mm]": off,
        "d [mm]": distance,
    }
    tables = {
        "points": Table.of(points),
        "residuals": test.residuals,
        "suspects": test.suspects(problem.keys_with_places),
    }
    effect_tables, arrays = effect_results(added, solution)
    tables |= effect_tables
    arrays = {"rotation": poses.rotation_of(pose), **arrays}
    result = Result(
        kind=KIND.name,
        title="",
        estimates=tuple(estimates),
        covariance=of_euler,
        statistics=statistics,
        tables=tables,
        arrays=arrays,
        warnings=tuple(warnings(problem, test)),
        shown=(ShownTable("points"),),
        notes=tuple(notes(problem, test, size, mirrored)),
    )
    shared = covariance[:own] @ change.T
    return result if laid is None else laid.added_to(result, np.concatenate([shared, -shared]))


def _moved(problem: PointPairs, at: tuple[Array, float], covariance: Array, tied: bool) -> tuple[Array, Array]:
    """Return the measured points after the transformation (n, 3), and their standard uncertainties.

    These are of the transformation at the point, and of the point itself where its list gives one.
    """
    pose, scale = at
    moved, slope = turned(problem.measured, pose, scale, len(covariance))
    turn = scale * poses.rotation_of(pose)
    own = turn @ problem.spread.own(0.0) @ turn.T
    shared, core = slope, covariance
    if tied:
        shared, core = _with_drawn(slope, covariance, _drawn(problem, own, slope))
    return moved, np.sqrt(np.einsum("nak,kl,nal->na", shared, core, shared) + np.einsum("naa->na", own))


def _drawn(problem: PointPairs, own: Array, slope: Array) -> Array:
    """Return how each measured point draws the transformation to its own errors, `O M^-1 A`, (n, 3, k).

    O is the covariance of the point in the nominal frame, M that of its deviation, and A its derivatives by the steps
    of the transformation, of covariance Q. The covariance of its errors and of those steps is `-O M^-1 A Q`.
    """
    used = np.isfinite(problem.nominal)
    nominal = np.eye(3) * problem.sigma[:, None, :] ** 2
    if problem.places is not None:
        free = problem.places.free[problem.places.of]
        listed_places = problem.places.spread.covariance[problem.places.of]
        nominal = nominal + np.where(free[:, :, None] & free[:, None, :], listed_places, 0.0)
    both = used[:, :, None] & used[:, None, :]
    # a coordinate that is not used draws nothing: in its place stands a row of the unit matrix
    deviation = np.where(both, own + nominal, np.eye(3))
    return np.asarray(own @ np.linalg.solve(deviation, np.where(used[:, :, None], slope, 0.0)))


def _with_drawn(slope: Array, covariance: Array, drawn: Array) -> tuple[Array, Array]:
    """Return derivatives (n, 3, 2k) and core (2k, 2k) that count what points and transformation share."""
    both = np.block([[covariance, -covariance], [-covariance, np.zeros_like(covariance)]])
    return np.concatenate([slope, drawn], axis=2), both


def _laid_features(
    problem: PointPairs, wanted: Sequence[RequestedFeature], at: tuple[Array, float], covariance: Array, tied: bool
) -> FittedFeatures | None:
    """Return the features through the points after the transformation, or None if none are wanted."""
    if not wanted:
        return None
    pose, scale = at
    moved, slope = turned(problem.list.stacked("xyz"), pose, scale, len(covariance))
    turn = scale * poses.rotation_of(pose)
    own = turn @ problem.list_spread.own(problem.noise) @ turn.T
    drawn = np.zeros_like(slope)
    if tied:
        rows = problem.rows
        drawn[rows] = _drawn(problem, np.nan_to_num(own[rows]), slope[rows])
    return fitted_features(wanted, FeaturePoints(problem.list, moved, own, *_with_drawn(slope, covariance, drawn)))


def warnings(problem: PointPairs, test: Tested) -> Iterator[str]:
    """Yield what a user of a best fit has to look at."""
    if test.exact:
        yield (
            f"all points fit to the rounding of their numbers (deviations below {test.rounding:.1g} mm), as where one "
            "list is calculated from the other. Nothing shows the noise of a measurement, so no uncertainty is stated; "
            "give `noise` or a column sigma_mm"
        )
    yield from problem.warnings
    if not problem.estimated:
        yield from noise_warnings(test.solution, ())
    if test.worst:
        names = [" ".join(parts) for parts in zip(*problem.keys_with_places.values(), strict=True)]
        named = [f"{names[row]} (w = {w:.1f})" for row, w in test.worst.items()]
        yield f"points that do not fit the others, beyond |w| = {test.critical:.2f}: {listed(named, 5)}"


def notes(problem: PointPairs, test: Tested, size: float, mirrored: float = float("nan")) -> Iterator[str]:
    """Yield the deviations of a best fit, and the noise that they show; `size`: their root mean square [mm]."""
    if test.exact:
        yield f"deviations of {len(problem.names)} points: none beyond rounding"
        return
    yield f"deviations of {len(problem.names)} points: root mean square {size:.4g} mm"
    if np.isfinite(mirrored) and mirrored < _NOTABLE * size:
        yield f"a mirror image would have {mirrored:.4g} mm; a rotation cannot give it, and this is a rotation"
    if problem.estimated:
        noise = (1.0 if problem.weighed else test.solution.sigma0) * problem.start_noise
        yield f"estimated noise of a coordinate: {noise:.3g} mm; covariances are scaled by it"
    else:
        yield from noise_notes(test.solution, ())
