"""The functions of fit-points."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.solution import Solution
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.effects.correlated import with_all
from metrocli.effects.model import Added
from metrocli.effects.wanted import Wanted
from metrocli.errors import InputError, NotConvergedError, UndeterminedError
from metrocli.result import Result
from metrocli.tasks.fit_points.diagnosis import adjusted_job, covariates
from metrocli.tasks.fit_points.effects import EFFECTS, PLACES
from metrocli.tasks.fit_points.features import features_alone
from metrocli.tasks.fit_points.problem import POSE, PointPairs, problem_of
from metrocli.tasks.fit_points.report import report
from metrocli.tasks.fit_points.settings import Files, Settings
from metrocli.tasks.fit_points.start import aligned_start, exchanged, mirrored_rms, rms, similarity
from metrocli.tasks.job import Job, Task
from metrocli.tasks.shared.features.wanted import wanted_features

_MIRRORED = 10.0
"""A mirror image is refused that makes the deviations so many times smaller"""


def run(job: Job[Settings, Files]) -> Result:
    """Return the best fit; raises InputError, UndeterminedError or NotConvergedError."""
    settings, points = job.settings, job.files.points
    wanted = wanted_features(settings.features, points, "points")
    if job.files.nominal is None:
        return features_alone(wanted, points, settings.noise)
    problem = problem_of(settings, job.files)
    mirrored = _of_the_mirror_image(problem)
    solution, added = solved(problem, job.effects)
    return report(problem, (solution, added), mirrored, wanted)


def diagnosed(job: Job[Settings, Files]) -> AdjustedJob:
    """Return the best fit in the form that diagnosis needs, with the noise that its residuals show where none is given.

    Raises the errors of `run`, InputError without nominal points, and UndeterminedError without degrees of freedom.
    """
    if job.files.nominal is None:
        raise InputError("only a best fit can be diagnosed: this job has no `nominal` points")
    problem = problem_of(job.settings, job.files)
    _of_the_mirror_image(problem)
    solution, added = solved(problem, job.effects)
    if solution.dof <= 0:
        raise UndeterminedError("there are no more readings than unknowns: no residual can show an error of the model")
    if problem.estimated:
        problem = replace(problem, noise=max(solution.sigma0 * problem.start_noise, problem.rounding))
        solution, added = solved(problem, job.effects)
    model = problem.model(solution.blocks[POSE].values[0], 1.0)
    return adjusted_job(replace(model, blocks=solution.blocks, groups=solution.groups, added=added))


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError that lists the faults of both lists, without computing."""
    wanted_features(job.settings.features, job.files.points, "points")
    if job.files.nominal is not None:
        problem_of(job.settings, job.files)


def solved(problem: PointPairs, wanted: Iterable[Wanted] = ()) -> tuple[Solution, tuple[Added, ...]]:
    """Return the adjustment, and the effects in its model.

    Raises InputError for effects that cannot act, UndeterminedError or NotConvergedError if it has no good solution.
    """
    if len(problem.full) == len(problem.names):
        pose, scale = similarity(problem.measured, problem.nominal, problem.scale)
    else:
        pose, scale = aligned_start(problem.measured, problem.nominal, problem.scale)
    model = with_all(problem.model(pose, scale), wanted)
    solution = adjust(model.blocks.values(), model.groups)
    if solution.undetermined or not solution.outcome.good:
        lines = [f"  undetermined: {combination}" for combination in solution.undetermined[:3]]
        text = "\n".join([f"{solution.outcome.value}: {solution.observations} readings", *lines])
        if solution.undetermined:
            help = "\n  what would determine it: three points that are not on a line, or more of their coordinates"
            raise UndeterminedError(text + help, solution.misfit)
        raise NotConvergedError(text, solution.misfit)
    return solution, model.added


def _of_the_mirror_image(problem: PointPairs) -> float:
    """Return the root mean square deviation of the mirror image [mm], nan where not all coordinates are used.

    Raises InputError if it is far smaller, or if it is with two names exchanged.
    """
    rows = problem.full
    if len(rows) < len(problem.names):
        return float("nan")
    as_listed = rms(problem.measured, problem.nominal, problem.scale)
    mirrored = mirrored_rms(problem.measured, problem.nominal, problem.scale)
    if len(rows) > 3 and mirrored * _MIRRORED < as_listed:
        raise InputError(
            "the measured points are a mirror image of the nominal ones: mirrored, they fit to "
            f"{mirrored:.3g} mm (root mean square), and to {as_listed:.3g} mm as they are; turn the sign of one axis "
            "in one of the lists"
        )
    names = exchanged(problem.measured, problem.nominal, problem.scale)
    if names is not None:
        one, other = (problem.names[i] for i in names)
        raise InputError(
            f"points {one} and {other} are exchanged in one of the lists: with their names exchanged the squared "
            "deviations are more than a hundred times smaller"
        )
    return mirrored if np.isfinite(mirrored) else float("nan")


TASK = Task(Files, run, check, diagnosed=diagnosed, effects=EFFECTS, places=PLACES, covariates=covariates)
