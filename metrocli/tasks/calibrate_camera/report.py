"""The result of a camera calibration: parameters with covariance, statistics, tables and warnings."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.schur.covariance import Covariance
from metrocli.adjust.solution import Residuals, Solution
from metrocli.arrays import Array, Index
from metrocli.effects.estimates import tables as effect_results
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.result import Result, ShownTable
from metrocli.table import Table
from metrocli.tasks.calibrate_camera import KIND
from metrocli.tasks.calibrate_camera.advice import correlation_warnings, folds, turned_too_little
from metrocli.tasks.calibrate_camera.diagnosis import uncontrolled
from metrocli.tasks.calibrate_camera.doubts import PrincipalPoint, principal_point, why_not
from metrocli.tasks.calibrate_camera.length_errors import LengthErrors, length_errors
from metrocli.tasks.calibrate_camera.lens_conventions import conventions_table, form_covariance, photogrammetric_form
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.projection_error import (
    SolvedCamera,
    angle_warnings,
    corner_warnings,
    coverage_note,
    coverage_statistics,
    projection_table,
)
from metrocli.tasks.calibrate_camera.readings import longer_than_listed, units_doubted
from metrocli.tasks.calibrate_camera.settings import CameraSettings, Settings
from metrocli.tasks.calibrate_camera.shape.found import link_of, shape_arrays, shape_notes, shape_rms, shape_table
from metrocli.tasks.calibrate_camera.wrong_images.turned import seen_from_behind
from metrocli.tasks.shared.images.adjustment import AdjustedImages
from metrocli.tasks.shared.images.camera_parameters import Parameters, parameters, pose_columns, unit_of
from metrocli.tasks.shared.images.tables import (
    adjustment_notes,
    depths,
    image_statistics,
    image_tables,
    image_warnings,
    points_of,
    with_places,
)
from metrocli.tasks.shared.statistics import Statistics, chi_interval, noise_notes, noise_warnings
from metrocli.tasks.shared.uncontrolled import TABLE, in_words


@dataclass(frozen=True)
class _Calibration:
    """A solved calibration with the parts that the report needs."""

    problem: CameraProblem
    settings: CameraSettings
    adjusted: AdjustedImages
    residuals: Residuals
    covariance: Covariance
    delivered: Parameters
    centre: PrincipalPoint | None

    @property
    def solution(self) -> Solution:
        return self.adjusted.solution

    @property
    def lens(self) -> Block:
        return self.solution.blocks[camera.LENS]

    @property
    def seen(self) -> SolvedCamera:
        problem, readings = self.problem, self.adjusted.group.observations.readings
        return SolvedCamera("", 0, problem.convention, problem.image_size, link_of(problem), readings)

    def index(self, name: str) -> Index:
        return self.adjusted.group.observations.index[name]


def report(problem: CameraProblem, job: Settings, adjusted: AdjustedImages, tests: Table | None = None) -> Result:
    """Return the result of a solved calibration; `tests` are lengths that test a network."""
    settings = job.camera
    solution = adjusted.solution
    covariance = solution.covariance_or_raise()
    p = parameters(problem.rig, solution, problem.effects)
    centre = principal_point(problem, adjusted)
    solved = _Calibration(problem, settings, adjusted, adjusted.known_residuals(), covariance, p, centre)
    tested = _tested(solved, tests, job) if tests is not None else None
    hidden = uncontrolled(problem, settings, adjusted, centre)
    tables, arrays = _tables_and_arrays(solved, hidden)
    statistics = _statistics(solved)
    if tested is not None:
        tables["length_errors"] = tested.table
    return Result(
        kind=KIND.name,
        title="",
        estimates=p.estimates,
        covariance=p.covariance,
        statistics={**statistics, **(tested.statistics if tested is not None else {})},
        tables=tables,
        arrays=arrays,
        warnings=(*_warnings(solved, tables.get("views")), *corner_warnings(statistics)),
        doubts=tuple(
            why_not(problem, settings, adjusted, centre, [text for text, among in folds(problem, adjusted) if among])
        ),
        shown=(ShownTable("views", ("image", "readings", "rms", "largest", "largest_target")),)
        if problem.rig == "board"
        else (),
        notes=(
            *(tested.notes if tested is not None else ()),
            *adjustment_notes(adjusted),
            coverage_note(statistics),
            *shape_notes(problem, solution, settings.model),
            *(noise_notes(solution) if adjusted.noise is None else ()),
            *in_words(hidden),
        ),
        details=adjusted.details(p.names),
    )


def _tables_and_arrays(solved: _Calibration, hidden: Table) -> tuple[dict[str, Table], dict[str, Array]]:
    """Return the tables of a calibration, and its covariances and correlations."""
    problem, settings, solution, adjusted = solved.problem, solved.settings, solved.solution, solved.adjusted
    p, covariance = solved.delivered, solved.covariance
    effect_tables, effect_arrays = effect_results(problem.effects, solution)
    arrays: dict[str, Array] = {"correlation": p.correlation, **effect_arrays, **shape_arrays(problem, solution)}
    form = photogrammetric_form(problem, settings, solution)
    if form is not None:
        arrays["photogrammetric_covariance"] = form_covariance(form, covariance)
    tables = image_tables(adjusted, solved.residuals, problem.sighted, "view") | {
        "correlations": p.high_correlations(),
        "significance": p.significance(),
        "conventions": conventions_table(problem, settings, solution, covariance),
        "camera": _camera(solved),
        **shape_table(problem, solution),
        TABLE: hidden,
        **effect_tables,
    }
    tables["targets"] = with_places(tables["targets"], solution)
    depth = float(np.median(np.abs(depths(adjusted.group, solution))))
    tables["projection_error"] = projection_table(solution, solved.seen, depth)
    if problem.rig == "cmm":
        del tables["views"]  # the machine gives their poses: they are not unknowns
    else:
        of_views = pose_columns(solution.blocks[camera.VIEW].values, covariance.members(camera.VIEW))
        tables["views"] = tables["views"].joined(of_views)
        arrays |= _view_covariances(solved)
    if problem.rig == "network" or (problem.rig == "board" and problem.blocks[camera.TARGET].free.any()):
        views = solution.blocks[camera.VIEW].values
        origins = (poses.inverse(views) if problem.rig == "board" else views)[:, :3]
        tables["points"], of_points = points_of(solution, solved.index(camera.TARGET), origins[solved.index("view")])
        arrays |= of_points
    return tables, arrays


def _tested(solved: _Calibration, tests: Table, job: Settings) -> LengthErrors:
    seen = np.bincount(solved.index(camera.TARGET), minlength=len(solved.problem.sighted.targets.names))
    return length_errors(tests, solved.solution, seen, job.length_limit)


def _statistics(solved: _Calibration) -> Statistics:
    problem, adjusted, solution, values = solved.problem, solved.adjusted, solved.solution, solved.residuals.values
    observations = adjusted.group.observations
    u_rms, v_rms = np.sqrt((values**2).mean(axis=1)).tolist()
    eigenvalues, _ = np.linalg.eigh(solved.delivered.correlation)
    low, high = chi_interval(solution)
    pixel = solved.settings.pixel_size
    own: Statistics = {
        "rank": solution.unknowns,
        "datum": "inner constraints on the targets" if solution.conditions else "given by known targets",
        "rms_u": u_rms,
        "rms_v": v_rms,
        "readings": observations.count,
        "rejected": len(adjusted.rejected),
        "images": len(problem.sighted.images),
        "targets": len(np.unique(observations.index[camera.TARGET])),
        **coverage_statistics(solution, solved.seen),
        "shape_rms": shape_rms(problem, solution),
        "sigma0_low": low,
        "sigma0_high": high,
        "condition": float(np.sqrt(eigenvalues.max(initial=1.0) / max(eigenvalues.min(initial=1.0), 1e-300))),
        "pixel_size": pixel if pixel is not None else float("nan"),
        "rig": problem.rig,
        "convention": problem.convention,
    }
    return image_statistics(adjusted, solved.residuals, own)


def _view_covariances(solved: _Calibration) -> dict[str, Array]:
    """Return the covariance of each view's pose (x y z alpha beta gamma), and that with the lens parameters."""
    values, covariance = solved.solution.blocks[camera.VIEW].values, solved.covariance
    change = poses.euler_form_by_step(values)
    each = change @ covariance.members(camera.VIEW) @ np.swapaxes(change, 1, 2)
    cross = covariance.between(camera.VIEW, camera.LENS).reshape(len(values), 6, -1)[:, :, solved.lens.free[0]]
    return {"views_covariance": each, "views_lens_covariance": change @ cross}


def _camera(solved: _Calibration) -> Table:
    """Return every lens parameter of the model, estimated or fixed, for jobs that use the camera."""
    lens, std = solved.lens, np.sqrt(np.diag(solved.covariance.of(camera.LENS)))
    units = [unit_of(name) for name in lens.columns]
    return Table.of({"parameter": lens.columns, "value": lens.values[0], "std": std, "unit": units})


def _warnings(solved: _Calibration, views: Table | None) -> list[str]:
    problem, adjusted = solved.problem, solved.adjusted
    lines = [*image_warnings(adjusted, problem.sighted, views), *units_doubted(longer_than_listed(problem))]
    lines += correlation_warnings(solved.delivered.high_correlations())
    adjusted_problem = problem.with_blocks({**problem.blocks, **solved.solution.blocks})
    lines += angle_warnings(adjusted_problem, solved.solution.std(camera.LENS)[0])
    lines += turned_too_little(adjusted_problem) + seen_from_behind(adjusted_problem)
    lines += noise_warnings(solved.solution, removed=len(adjusted.rejected)) if adjusted.noise is None else []
    lines += solved.centre.warnings() if solved.centre is not None else []
    return lines + [text for text, among in folds(solved.problem, adjusted) if not among]
