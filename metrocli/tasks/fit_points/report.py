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
from metrocli.tasks.fit_points.tested import Tested, tested
from metrocli.tasks.shared.features.requested import RequestedFeature
from metrocli.tasks.shared.rounding import without_rounding
from metrocli.tasks.shared.statistics import basic_statistics, noise_notes, noise_warnings, with_noise
from metrocli.words import listed

_NOTABLE = 0.95
"""A mirror image is named that has so many times the deviations or fewer"""
_RIGID = 6
"""Unknowns of a transformation without a scale"""


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
    own = _RIGID + scaled
    moved, std = _moved(problem, (pose, scale), covariance[:own, :own], factor)
    moved = without_rounding(moved, rounding)
    laid = _laid_features(problem, wanted, (pose, scale), covariance[:own, :own], factor)
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
    return result if laid is None else laid.added_to(result, covariance[:own] @ change.T)


def _turned(points: Array, pose: Array, scale: float, unknowns: int) -> tuple[Array, Array]:
    """Return points after the transformation (n, 3), and their derivatives by its steps (n, 3, 6 or 7)."""
    turned = scale * points @ poses.rotation_of(pose).T
    slope = np.zeros((len(turned), 3, unknowns))
    slope[:, :, :3] = np.eye(3)
    x, y, z = turned.T
    slope[:, 0, 4], slope[:, 0, 5], slope[:, 1, 3] = z, -y, -z
    slope[:, 1, 5], slope[:, 2, 3], slope[:, 2, 4] = x, y, -x
    if unknowns > _RIGID:
        slope[:, :, _RIGID] = turned / scale
    return turned + pose[:3], slope


def _moved(problem: PointPairs, at: tuple[Array, float], covariance: Array, factor: float) -> tuple[Array, Array]:
    """Return the measured points after the transformation (n, 3), and their standard uncertainties.

    These are of the transformation at the point, and of the point itself where its list gives one.
    """
    pose, scale = at
    moved, slope = _turned(problem.measured, pose, scale, len(covariance))
    variance = np.einsum("nak,kl,nal->na", slope, covariance, slope)
    turn = scale * factor * poses.rotation_of(pose)
    return moved, np.sqrt(variance + np.einsum("ab,nbc,ac->na", turn, problem.spread.own(0.0), turn))


def _laid_features(
    problem: PointPairs, wanted: Sequence[RequestedFeature], at: tuple[Array, float], covariance: Array, factor: float
) -> FittedFeatures | None:
    """Return the features through the points after the transformation, or None if none are wanted."""
    if not wanted:
        return None
    pose, scale = at
    moved, slope = _turned(problem.list.stacked("xyz"), pose, scale, len(covariance))
    turn = scale * factor * poses.rotation_of(pose)
    own = turn @ problem.list_spread.own(problem.noise) @ turn.T
    return fitted_features(wanted, FeaturePoints(problem.list, moved, own, slope, covariance))


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
        noise = test.solution.sigma0 * problem.start_noise
        yield f"estimated noise of a coordinate: {noise:.3g} mm; covariances are scaled by it"
    else:
        yield from noise_notes(test.solution, ())
