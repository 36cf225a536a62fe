"""The result of a part's alignment: estimates with covariance, statistics, tables and warnings."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from metrocli.adjust.adjustment import covariance_at
from metrocli.adjust.solution import Residuals, Solution
from metrocli.arrays import Array
from metrocli.effects.estimates import absorbed_in_words, free_blocks
from metrocli.effects.estimates import estimates as effect_estimates
from metrocli.effects.estimates import tables as effect_results
from metrocli.effects.model import Added
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments import spindle_camera as spindle
from metrocli.instruments.camera import TARGET
from metrocli.result import Result, ShownTable
from metrocli.table import Table
from metrocli.tasks.align_part import KIND
from metrocli.tasks.align_part.diagnosis import uncontrolled
from metrocli.tasks.align_part.effects import EXPANSION
from metrocli.tasks.align_part.fixturing import corrections, predicted_points
from metrocli.tasks.align_part.problem import AlignmentProblem
from metrocli.tasks.align_part.settings import Files
from metrocli.tasks.shared.images.adjustment import AdjustedImages
from metrocli.tasks.shared.images.camera_parameters import HIGH_CORRELATION, Parameters, with_effects
from metrocli.tasks.shared.images.exposures import IMAGE
from metrocli.tasks.shared.images.tables import adjustment_notes, image_statistics, image_tables, image_warnings
from metrocli.tasks.shared.joint_covariance import owed
from metrocli.tasks.shared.statistics import Statistics, noise_notes, noise_warnings
from metrocli.tasks.shared.uncontrolled import TABLE, in_words

_UNITS = ("mm", "mm", "mm", "rad", "rad", "rad", "rad")


@dataclass(frozen=True)
class AnglePrediction:
    """Uncertainty of the clamping angle that follows from poses and targets alone, before the readings are fitted."""

    std: float
    """Standard uncertainty of gamma_s [rad]"""
    correlation: float
    """Largest correlation of gamma_s with an angle of the part"""
    partner: str
    """That angle: alpha, beta or gamma"""


def predicted(problem: AlignmentProblem) -> AnglePrediction | None:
    """Return the predicted standard uncertainty of gamma_s and its correlation with the part's rotation.

    None for the 6D job, and if the design is rank deficient.
    """
    if not problem.free_angle:
        return None
    design = covariance_at(problem.blocks.values(), [problem.images, *problem.others], problem.datum)
    if design.covariance is None:
        return None
    p = _parameters(design)
    correlation = p.correlation[6, 3:6]
    worst = int(np.argmax(np.abs(correlation)))
    return AnglePrediction(float(p.std[6]), float(correlation[worst]), p.names[3 + worst])


def delivered(effects: Sequence[Added] = ()) -> tuple[str, ...]:
    """Return the blocks of the estimates."""
    return (spindle.PART, spindle.COUPLING, *free_blocks(effects))


def _parameters(solution: Solution, effects: Sequence[Added] = ()) -> Parameters:
    """Return x y z alpha beta gamma, gamma_s in 7D, and the effects."""
    pose = solution.blocks[spindle.PART].values[0]
    angle = solution.blocks[spindle.COUPLING]
    turns = [math.remainder(float(turn), math.tau) for turn in angle.values[angle.free]]
    names, values = (*poses.EULER, *["gamma_s"] * len(turns)), np.concatenate([poses.euler_form(pose), turns])
    joint, change = solution.joint(delivered(effects)), poses.euler_form_by_step(pose)
    return with_effects(names, values, _UNITS[: len(names)], joint, change, effect_estimates(effects, solution))


def report(
    problem: AlignmentProblem, adjusted: AdjustedImages, prediction: AnglePrediction | None, files: Files
) -> Result:
    """Return the result of a solved alignment, with the corrections of its fixture and the points to gauge."""
    solution = adjusted.solution
    residuals = adjusted.known_residuals()
    p = _parameters(solution, problem.effects)
    pose = solution.blocks[spindle.PART].values[0]
    tables, arrays = _tables(problem, adjusted, residuals)
    tables[TABLE] = uncontrolled(problem, adjusted, files)
    arrays |= {"rotation": poses.rotation_of(pose), "correlation": p.correlation}
    details = adjusted.details(p.names)
    estimated = math.inf if adjusted.noise is None else float(solution.dof)
    dof = min((details[angle]["dof"] for angle in ("alpha", "beta") if angle in details), default=estimated)
    fixture = corrections(p.values[:6], p.covariance[:6, :6], files.supports, dof)
    tables |= fixture.tables
    if files.points is not None:
        known = [*range(6), *(k for k, name in enumerate(p.names) if name.startswith(f"{EXPANSION}."))]
        joint = p.covariance[np.ix_(known, known)]
        tables["points"], of_points = predicted_points(files.points, pose, joint, _growth(problem, solution))
        arrays |= of_points
    return Result(
        kind=KIND.name,
        title="",
        estimates=p.estimates,
        covariance=p.covariance,
        statistics=_statistics(problem, adjusted, residuals, prediction),
        tables=tables,
        arrays=arrays,
        warnings=(*_warnings(problem, adjusted, tables["views"], prediction), *fixture.warnings),
        shown=(ShownTable("views", ("image", "readings", "rms", "largest", "largest_target")),),
        notes=(
            *_notes(solution, adjusted, prediction),
            *problem.notes,
            *([] if problem.part is None else [problem.part.note_of_listed]),
            *fixture.notes,
            *in_words(tables[TABLE]),
        ),
        details=details,
    )


def _tables(
    problem: AlignmentProblem, adjusted: AdjustedImages, residuals: Residuals
) -> tuple[dict[str, Table], dict[str, Array]]:
    """Return the tables of readings, views and targets, of effects, and of what is owed."""
    tables = image_tables(adjusted, residuals, problem.sighted, IMAGE)
    tables["targets"] = _targets(adjusted, tables["targets"])
    effect_tables, effect_arrays = effect_results(problem.effects, adjusted.solution)
    owed_tables, owed_arrays = ({}, {}) if adjusted.structured is not None else _owed(problem, adjusted.solution)
    return tables | effect_tables | owed_tables, effect_arrays | owed_arrays


def _targets(adjusted: AdjustedImages, table: Table) -> Table:
    """Return the table of targets with their estimated coordinates in the part frame, if any of them is an unknown."""
    block = adjusted.solution.blocks[TARGET]
    if not block.free.any():
        return table
    rows = [block.members.index(name) for name in table.texts("target")]
    std = np.sqrt(np.einsum("mii->mi", adjusted.solution.covariance_or_raise().members(TARGET)[rows]))
    return table.joined({"x y z [mm]": block.values[rows], "sx sy sz [mm]": std})


def _growth(problem: AlignmentProblem, solution: Solution) -> float:
    """Return by how much the part has grown in all, by what is known and what is estimated."""
    grown = (solution.blocks[added.block].values[-1, 0] for added in problem.effects if added.effect.name == EXPANSION)
    return float(sum(grown))


def _statistics(
    problem: AlignmentProblem, adjusted: AdjustedImages, residuals: Residuals, prediction: AnglePrediction | None
) -> Statistics:
    """Return the statistics of the adjustment, and what is predicted of the clamping angle."""
    own: Statistics = {
        "readings": adjusted.group.observations.count,
        "rejected": len(adjusted.rejected),
        "images": len(problem.sighted.images),
    }
    statistics = image_statistics(adjusted, residuals, own)
    if prediction is not None:
        statistics |= {"predicted_std_gamma_s": prediction.std, "predicted_correlation_gamma_s": prediction.correlation}
    return statistics


def _owed(problem: AlignmentProblem, solution: Solution) -> tuple[dict[str, Table], dict[str, Array]]:
    """Return what the estimates owe to camera, targets and machine, where these have a joint covariance."""
    correlated = [group for group in problem.others if group.observations.covariance is not None]
    inputs = {"targets" if TARGET in group.chain.blocks else "camera": group for group in correlated}
    blocks = delivered(problem.effects)
    change = np.eye(sum(int(solution.blocks[name].free.sum()) for name in blocks))
    change[:6, :6] = poses.euler_form_by_step(solution.blocks[spindle.PART].values[0])
    return owed(solution, blocks, change, inputs, problem.sources)


def _notes(solution: Solution, adjusted: AdjustedImages, prediction: AnglePrediction | None) -> list[str]:
    rotation = poses.rotation_of(solution.blocks[spindle.PART].values[0])
    lines = ["rotation of the part into the machine, R_P ="]
    lines += ["    " + "  ".join(f"{entry:+.8f}" for entry in row) for row in rotation]
    if prediction is not None:
        lines.append(
            f"predicted from the poses before solving: s(gamma_s) = {prediction.std:.2g} rad, "
            f"correlation with {prediction.partner} {prediction.correlation:+.3f}"
        )
    lines += noise_notes(solution) if adjusted.noise is None else []
    return lines + adjustment_notes(adjusted)


def _warnings(
    problem: AlignmentProblem, adjusted: AdjustedImages, views: Table, prediction: AnglePrediction | None
) -> list[str]:
    lines = list(problem.warnings)
    if problem.camera.covariance is None:
        lines.append("the camera is taken as exact: its file contains no covariance")
    if prediction is not None and abs(prediction.correlation) > HIGH_CORRELATION:
        lines.append(
            f"gamma_s and the part's {prediction.partner} are correlated {prediction.correlation:+.3f}: "
            "the images hardly separate them; "
            "take images from positions further apart, or with the spindle turned by 90 or 180 degrees"
        )
    lines = image_warnings(adjusted, problem.sighted, views, lines)
    return lines + (noise_warnings(adjusted.solution, removed=len(adjusted.rejected)) if adjusted.noise is None else [])


def explained(problem: AlignmentProblem, solution: Solution) -> str:
    """Return the message of an undetermined alignment: which unknowns, why, and what would determine them."""
    lines = [f"{solution.outcome.value}: {solution.observations} readings, {solution.unknowns} unknowns"]
    lines += [f"  undetermined: {_in_words(str(combination))}" for combination in solution.undetermined[:3]]
    columns = {column for combination in solution.undetermined for _, column, _, _ in combination.parts}
    if hidden := absorbed_in_words(problem.effects, solution, problem.datum):
        lines += hidden
    elif "gamma_s" in columns:
        lines += [
            "  why: the clamping angle and the part's rotation change the images in the same way",
            "  what would determine it: images from several positions of the spindle, far apart across its axis, "
            "or `estimate: [part-pose]`",
        ]
    else:
        targets = len(np.unique(problem.sighted.target))
        lines += [
            f"  why: {targets} targets in {len(problem.sighted.images)} images",
            "  what would determine it: three or more targets not on a line, "
            "each seen from two places, or two or more of them in one image",
        ]
    return "\n".join(lines)


def _in_words(text: str) -> str:
    """Replace the names of internal blocks."""
    for block in (spindle.PART, spindle.COUPLING):
        text = text.replace(f" of {block}", " of the part" if block == spindle.PART else "")
    return text
