"""The result of several cameras: the lens of each and its pose in the frame of the first, with their covariance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from metrocli import units
from metrocli.adjust.solution import Residuals, Solution
from metrocli.arrays import Array
from metrocli.effects.estimates import free_blocks
from metrocli.effects.estimates import tables as effect_results
from metrocli.effects.links.lens_shape import LensShape
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.lenses.conventions import projection_range
from metrocli.result import Result, ShownTable
from metrocli.table import Table
from metrocli.tasks.calibrate_camera import KIND
from metrocli.tasks.calibrate_camera.advice import correlation_warnings, unfolded
from metrocli.tasks.calibrate_camera.diagnosis import PITCH
from metrocli.tasks.calibrate_camera.length_errors import length_errors
from metrocli.tasks.calibrate_camera.multi_camera.alone import doubts_and_warnings, view_warnings, views_of
from metrocli.tasks.calibrate_camera.multi_camera.system import CameraSystem
from metrocli.tasks.calibrate_camera.projection_error import (
    SolvedCamera,
    corner_warnings,
    coverage_note,
    coverage_statistics,
    projection_table,
)
from metrocli.tasks.calibrate_camera.settings import Files, Settings
from metrocli.tasks.calibrate_camera.shape.found import coefficients, rms_of
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.adjustment import AdjustedImages
from metrocli.tasks.shared.images.calibrated import CAMERAS, LENS_SHAPE
from metrocli.tasks.shared.images.camera_parameters import Parameters, parameters_of, pose_columns, unit_of
from metrocli.tasks.shared.images.exposures import IMAGE
from metrocli.tasks.shared.images.settings import SPLINE
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
from metrocli.tasks.shared.uncontrolled import SCALE, SCALE_WORDS, TABLE, Hidden, in_words, table_of


def delivered(system: CameraSystem) -> tuple[str, ...]:
    """Return the blocks of the estimates."""
    return (camera.LENS, camera.MOUNT, *((camera.TAPER,) if system.rig == "cmm" else ()), *free_blocks(system.effects))


def report(system: CameraSystem, adjusted: AdjustedImages, job: Job[Settings, Files]) -> Result:
    """Return the result of several cameras that were adjusted together."""
    solution, residuals = adjusted.solution, adjusted.known_residuals()
    p = parameters(system, solution)
    effects, arrays = effect_results(system.effects, solution)
    tables = image_tables(adjusted, residuals, system.sighted, IMAGE) | {
        "correlations": p.high_correlations(),
        "significance": p.significance(),
        "camera": _lens_table(solution),
        CAMERAS: _cameras(system, solution),
        **effects,
    }
    tables["targets"] = with_places(tables["targets"], solution)
    tables["projection_error"], coverages = _projection_error(system, adjusted)
    tables[TABLE] = table_of(_not_controlled(system, solution))
    shapes = {solution.blocks[camera.LENS].members[link.member or 0]: link for link in system.shapes}
    if shapes:
        tables[LENS_SHAPE] = Table.stack(
            [
                Table.of({"camera [text]": [name] * (link.knots.size // 2), **coefficients(link, solution)})
                for name, link in shapes.items()
            ]
        )
    if system.rig != "cmm":
        tables["views"] = tables["views"].joined(pose_columns(*views_of(system, solution)))
    tested, tests = None, job.files.test_lengths
    if system.rig == "network":
        tables["points"], of_points = _points(solution, adjusted)
        arrays |= of_points
    if tests is not None:
        seen = np.bincount(
            adjusted.group.observations.index[camera.TARGET], minlength=len(system.sighted.targets.names)
        )
        tested = length_errors(tests, solution, seen, job.settings.length_limit)
        tables["length_errors"] = tested.table
    warnings = image_warnings(adjusted, system.sighted, tables["views"])
    warnings += correlation_warnings(p.high_correlations())
    folds = list(_folds(system, adjusted))
    folding = {name: line for name, line, among in folds if among}
    doubts, contradicted = doubts_and_warnings(system, job.settings, adjusted, folding)
    warnings += [*view_warnings(system, solution), *contradicted]
    warnings += [f"{name}: {line}" for name, of_camera in coverages.items() for line in corner_warnings(of_camera)]
    warnings += [f"{name}: {line}" for name, line, among in folds if not among]
    known = adjusted.noise is None
    statistics = {**_statistics(system, adjusted, residuals), **_worst(coverages)}
    return Result(
        kind=KIND.name,
        title="",
        estimates=p.estimates,
        covariance=p.covariance,
        statistics={**statistics, **(tested.statistics if tested is not None else {})},
        tables=tables,
        arrays={"correlation": p.correlation, **arrays},
        warnings=(*warnings, *(noise_warnings(solution, removed=len(adjusted.rejected)) if known else ())),
        doubts=tuple(doubts),
        shown=(ShownTable(CAMERAS, ("camera", "x", "y", "z", "alpha", "beta", "gamma")),),
        notes=(
            *(tested.notes if tested is not None else ()),
            *adjustment_notes(adjusted),
            *(f"{name}: {coverage_note(of_camera)}" for name, of_camera in coverages.items()),
            *_baselines(solution),
            *_of_shapes(system, shapes, solution),
            *(noise_notes(solution) if known else ()),
            *in_words(tables[TABLE]),
        ),
        details=adjusted.details(p.names),
    )


def _of_shapes(system: CameraSystem, shapes: Mapping[str, LensShape], solution: Solution) -> Iterator[str]:
    for name, camera_settings in system.cameras.items():
        if name in shapes:
            size = rms_of(shapes[name], solution)
            yield f"shape of the lens of {name} beside its base: {size:.2g} px (rms over the image)"
        elif camera_settings.model == SPLINE:
            yield f"the readings show no shape of the lens of {name} beside its base: its result is that of the base"


def _projection_error(system: CameraSystem, adjusted: AdjustedImages) -> tuple[Table, dict[str, Statistics]]:
    """Return how well each camera projects over its image, at the distance of its targets, and its coverage."""
    solution, observations = adjusted.solution, adjusted.group.observations
    depth, camera_of = np.abs(depths(adjusted.group, solution)), observations.index[camera.LENS]
    tables, coverages = [], dict[str, Statistics]()
    for number, name in enumerate(solution.blocks[camera.LENS].members):
        rows = camera_of == number
        shape = next((shape for shape in system.shapes if shape.member == number), None)
        readings, convention = observations.readings[:, rows], system.conventions[number]
        solved = SolvedCamera(name, number, convention, system.size(name), shape, readings)
        tables.append(projection_table(solution, solved, float(np.median(depth[rows]))))
        coverages[name] = coverage_statistics(solution, solved)
    return Table.stack(tables), coverages


def _worst(coverages: Mapping[str, Statistics]) -> Statistics:
    """Return the coverage of the camera that is known worst in a corner, for the size of its image, with its name."""

    def uncertain(name: str) -> float:
        corner, width, height = (coverages[name][key] for key in ("corner_std", "image_width", "image_height"))
        return float(corner) / max(float(width), float(height))  # type: ignore[arg-type]

    worst = max(coverages, key=uncertain)
    return {**coverages[worst], "worst_camera": worst}


def _not_controlled(system: CameraSystem, solution: Solution) -> Iterator[Hidden]:
    """Yield the scale, on which the distances of the cameras from each other depend, and no residual."""
    far = float(np.linalg.norm(solution.blocks[camera.MOUNT].values[1:, :3], axis=1).max(initial=0.0))
    if system.rig == "board":
        what, assumed, share = "pitch, or scale of the target list", "0.1 %", PITCH
        control = "the board measured over its whole length"
    else:
        what, assumed, share = "common scale of the targets, or of the scale bars", SCALE_WORDS, SCALE
        control = "temperature and calibration of what placed the targets, or of the scale bars"
    yield Hidden(f"{what} (distances of the cameras from each other)", assumed, share * far, control)


def _points(solution: Solution, adjusted: AdjustedImages) -> tuple[Table, dict[str, Array]]:
    """Return the points of a network, each seen from the places of the cameras at its exposures."""
    index = adjusted.group.observations.index
    first, mount = solution.blocks[camera.VIEW].values, solution.blocks[camera.MOUNT].values
    origins = poses.compose(first[index["view"]], mount[index[camera.MOUNT]])[:, :3]
    return points_of(solution, index[camera.TARGET], origins)


def parameters(system: CameraSystem, solution: Solution) -> Parameters:
    """Return the lens of each camera, then the pose of each but the first, named `right.f`, `right.x`, and effects.

    The pose is that of the camera in the frame of the first, as x y z alpha beta gamma: `X_first = R X_camera + d`.
    """
    mount = solution.blocks[camera.MOUNT]
    placed = [(f"{name}.", pose) for name, pose in zip(mount.members[1:], mount.values[1:], strict=True)]
    if system.rig == "cmm":
        placed.append((f"{mount.members[0]}.", solution.blocks[camera.TAPER].values[0]))
    prefixes = [f"{name}." for name in solution.blocks[camera.LENS].members]
    return parameters_of(prefixes, placed, solution, delivered(system), system.effects)


def _lens_table(solution: Solution) -> Table:
    """Return every lens parameter of every camera, estimated or fixed."""
    lens = solution.blocks[camera.LENS]
    count, size = lens.values.shape
    columns = {
        "camera [text]": np.repeat(np.array(lens.members), size),
        "parameter [text]": np.tile(lens.columns, count),
    }
    numbers = {"value": lens.values.ravel(), "std": solution.std(camera.LENS).ravel()}
    return Table.of({**columns, **numbers, "unit [text]": np.tile([unit_of(name) for name in lens.columns], count)})


def _cameras(system: CameraSystem, solution: Solution) -> Table:
    """Return names and size of the images of each camera, and its pose in the frame of the first."""
    mount = solution.blocks[camera.MOUNT]
    sizes = np.array([system.size(name) for name in mount.members])
    named = [system.cameras[name].images for name in mount.members]
    own = {"camera [text]": mount.members, "convention [text]": system.conventions, "images [text]": named}
    of_size = {"image_width": sizes[:, 0], "image_height": sizes[:, 1]}
    return Table.of(
        {**own, **of_size, **pose_columns(mount.values, solution.covariance_or_raise().members(camera.MOUNT))}
    )


def _statistics(system: CameraSystem, adjusted: AdjustedImages, residuals: Residuals) -> Statistics:
    observations = adjusted.group.observations
    low, high = chi_interval(adjusted.solution)
    own: Statistics = {
        "readings": observations.count,
        "rejected": len(adjusted.rejected),
        "images": len(system.sighted.images),
        "exposures": len(system.exposed.names),
        "targets": len(np.unique(observations.index[camera.TARGET])),
        "sigma0_low": low,
        "sigma0_high": high,
        "rig": system.rig,
        "convention": " and ".join(dict.fromkeys(system.conventions)),
    }
    return image_statistics(adjusted, residuals, own)


def _baselines(solution: Solution) -> Iterator[str]:
    """Yield how far each camera is from the first, and how much it is turned."""
    mount = solution.blocks[camera.MOUNT]
    each = solution.covariance_or_raise().members(camera.MOUNT)
    for name, pose, covariance in zip(mount.members[1:], mount.values[1:], each[1:], strict=True):
        far = float(np.linalg.norm(pose[:3]))
        along = pose[:3] / max(far, 1e-300)
        std = float(np.sqrt(along @ covariance[:3, :3] @ along))
        turn = float(np.degrees(np.linalg.norm(pose[3:])))
        yield f"{name} is {units.format_quantity(far, 'mm', std)} from {mount.members[0]}, turned by {turn:.3g} degrees"


def _folds(system: CameraSystem, adjusted: AdjustedImages) -> Iterator[tuple[str, str, bool]]:
    """Yield cameras whose lens model folds over inside the image, with where, and whether readings are so far out."""
    observations, lens = adjusted.group.observations, adjusted.solution.blocks[camera.LENS]
    for number, name in enumerate(lens.members):
        values = lens.named(name)
        fold = None
        if system.conventions[number] != "backward":
            fold = projection_range(values, system.size(name), system.conventions[number] == "fisheye")
        u, v = observations.readings[:, observations.index[camera.LENS] == number]
        if fold is not None:
            among = bool(np.hypot(u - values["cx"], v - values["cy"]).max(initial=0.0) >= fold)
            where = "among the readings" if among else "inside the image"
            line = f"the lens model folds over at {fold:.0f} px from the principal point, {where}"
            yield name, f"{line}; {unfolded(lens, number)}", among
