"""The result of a best fit: transformation, moved points with their uncertainty, deviations and their tests."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import FitQuality, Suspects, suspects
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.arrays import Array, Index
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
from metrocli.tasks.fit_points.features import FeaturePoints, FittedFeatures, fitted_features, own_sigma
from metrocli.tasks.fit_points.problem import POINT, POSE, PointPairs
from metrocli.tasks.shared.features.wanted import RequestedFeature
from metrocli.tasks.shared.rounding import without_rounding
from metrocli.tasks.shared.statistics import basic_statistics, noise_notes, noise_warnings, residual_table, with_noise
from metrocli.words import listed

_NOTABLE = 0.95
"""A mirror image is named that has so many times the deviations or fewer"""
_CONTROLLED = 1e-6
"""Redundancy from which a reading has a test of its own"""
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
    solution, added = solved
    estimated = problem.estimated
    factor = solution.sigma0 if estimated and solution.dof > 0 else 1.0
    exact = estimated and factor * problem.start_noise <= problem.rounding
    rounding, factor = (problem.rounding, 0.0) if exact else (0.0, factor)
    of_angles = rounding / (float(np.ptp(problem.measured, axis=0).max()) or 1.0)
    pose, scale = solution.blocks[POSE].values[0], 1.0 + float(solution.blocks[SCALE].values[0, 0])
    scaled = bool(solution.blocks[SCALE].free.any())
    certain = replace(solution, covariance=solution.covariance_or_raise().scaled(factor**2))
    covariance = certain.joint((POSE, *((SCALE,) if scaled else ()), *free_blocks(added)))
    groups = solution.groups[: sum(group.name in "xyz" for group in solution.groups)]
    read = [residuals_of(solution, group) for group in groups]
    everything = [residuals_of(solution, group) for group in solution.groups]
    members = np.concatenate(
        [np.tile(_points_of(group), len(group.observations.readings)) for group in solution.groups]
    )
    tested = suspects(_merged(everything), FitQuality(solution.cost, solution.dof, not estimated))
    worst = _by_point(problem, tested, members)
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
    estimates += estimates_of_effects(added, certain)
    distance = np.sqrt(np.nansum(off**2, axis=1))
    size = float(np.sqrt((distance**2).mean()))
    statistics = basic_statistics(solution, {"mm": size}) | {"points": len(problem.names), "mirrored_rms": mirrored}
    if estimated:
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
        "residuals": Table.stack(
            [residual_table(_in_noise(residuals, factor), group) for residuals, group in zip(read, groups, strict=True)]
        ),
        "suspects": Table.of({"point [text]": list(worst), "w": list(worst.values())}),
    }
    effect_tables, arrays = effect_results(added, certain)
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
        warnings=(*_exactness(exact, rounding), *_warnings(problem, solution, tested.critical, worst)),
        shown=(ShownTable("points"),),
        notes=tuple(_notes(problem, solution, size, mirrored, exact)),
    )
    return result if laid is None else laid.added_to(result, covariance[:own] @ change.T)


def _in_noise(residuals: Residuals, factor: float) -> Residuals:
    """Return residuals relative to the noise that is found: that of the adjustment times a factor; 0: no noise.

    They are not controlled where the errors are those of the measured points, whose own list tests them.
    """
    controlled = (residuals.redundancy > _CONTROLLED) & (factor > 0)
    normalised = np.where(controlled, residuals.normalised / (factor or 1.0), np.nan)
    return replace(residuals, sigma=residuals.sigma * factor, normalised=normalised)


def _merged(read: list[Residuals]) -> Residuals:
    """Return the residuals of all coordinates, group by group and axis by axis, as readings of one component."""
    parts = ("values", "sigma", "redundancy", "normalised")
    return Residuals(
        *(np.concatenate([_flat(getattr(residuals, part), residuals) for residuals in read])[None] for part in parts)
    )


def _flat(values: Array, residuals: Residuals) -> Array:
    return np.broadcast_to(values, residuals.values.shape).ravel()


def _points_of(group: Group) -> Index:
    """Return the point of each coordinate of a group: a nominal one, or what the list of measured points observes."""
    return np.tile(np.asarray(group.observations.index[POINT]).ravel(), len(group.observations.readings))


def _by_point(problem: PointPairs, suspected: Suspects, members: Index) -> dict[str, float]:
    """Return the largest test of each point that has one beyond the bound, the largest first."""
    order = np.argsort(-suspected.tests)
    worst: dict[str, float] = {}
    for row, test in zip(members[suspected.rows[order]].tolist(), suspected.tests[order].tolist(), strict=True):
        worst.setdefault(problem.names[row], test)
    return worst


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
    own = np.nan_to_num(problem.measured_sigma) ** 2 @ (poses.rotation_of(pose).T ** 2)
    return moved, np.sqrt(variance + (scale * factor) ** 2 * own)


def _laid_features(
    problem: PointPairs, wanted: Sequence[RequestedFeature], at: tuple[Array, float], covariance: Array, factor: float
) -> FittedFeatures | None:
    """Return the features through the points after the transformation, or None if none are wanted."""
    if not wanted:
        return None
    pose, scale = at
    moved, slope = _turned(problem.list.stacked("xyz"), pose, scale, len(covariance))
    turn = scale * factor * poses.rotation_of(pose)
    own = turn @ (np.eye(3) * own_sigma(problem.list, problem.noise)[:, None, :] ** 2) @ turn.T
    return fitted_features(wanted, FeaturePoints(problem.list, moved, own, slope, covariance))


def _exactness(exact: bool, rounding: float) -> Iterator[str]:
    if exact:
        yield (
            f"all points fit to the rounding of their numbers (deviations below {rounding:.1g} mm), as where one list "
            "is calculated from the other. Nothing shows the noise of a measurement, so no uncertainty is stated; give "
            "`noise` or a column sigma_mm"
        )


def _warnings(problem: PointPairs, solution: Solution, critical: float, worst: dict[str, float]) -> Iterator[str]:
    yield from problem.warnings
    if not problem.estimated:
        yield from noise_warnings(solution, ())
    if worst:
        named = [f"{point} (w = {test:.1f})" for point, test in worst.items()]
        yield f"points that do not fit the others, beyond |w| = {critical:.2f}: {listed(named, 5)}"


def _notes(problem: PointPairs, solution: Solution, size: float, mirrored: float, exact: bool) -> Iterator[str]:
    if exact:
        yield f"deviations of {len(problem.names)} points: none beyond rounding"
        return
    yield f"deviations of {len(problem.names)} points: root mean square {size:.4g} mm"
    if np.isfinite(mirrored) and mirrored < _NOTABLE * size:
        yield f"a mirror image would have {mirrored:.4g} mm; a rotation cannot give it, and this is a rotation"
    if problem.estimated:
        noise = solution.sigma0 * problem.start_noise
        yield f"estimated noise of a coordinate: {noise:.3g} mm; covariances are scaled by it"
    else:
        yield from noise_notes(solution, ())
