"""The functions of fit-points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.rounds import in_rounds
from metrocli.adjust.solution import Solution
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.effects.correlated import with_all
from metrocli.effects.model import Added
from metrocli.effects.requested import RequestedEffect, keys_of
from metrocli.errors import InputError, NotConvergedError, UndeterminedError
from metrocli.result import Result
from metrocli.tasks.fit_points.diagnosis import adjusted_job, covariates
from metrocli.tasks.fit_points.effects import EFFECTS, PLACES
from metrocli.tasks.fit_points.features import features_alone
from metrocli.tasks.fit_points.joined import joined
from metrocli.tasks.fit_points.listed import table_of
from metrocli.tasks.fit_points.problem import PointPairs, problem_of
from metrocli.tasks.fit_points.report import report
from metrocli.tasks.fit_points.settings import Files, Settings, refuse_nothing_to_do
from metrocli.tasks.fit_points.start import aligned_start, mirrored, similarity
from metrocli.tasks.fit_points.stations import stations_of
from metrocli.tasks.fit_points.tested import noise_of
from metrocli.tasks.job import Job, Task
from metrocli.tasks.shared.features.requested import requested_features

_SETTLED = 1e-3
"""Relative change of an estimated noise at which it no longer changes"""


def run(job: Job[Settings, Files]) -> Result:
    """Return the best fit; raises InputError, UndeterminedError or NotConvergedError."""
    settings, files = job.settings, job.files
    refuse_nothing_to_do(settings, files)
    if files.stations:
        problem, solution, _ = solved(_of_stations(job))
        return joined(problem, solution)
    requested = requested_features(settings.features, table_of(files.points), "points")
    if files.nominal is None:
        _without_effects(job)
        return features_alone(requested, files.points, settings.noise)
    problem = _started(problem_of(settings, files))
    mirror = _of_the_mirror_image(problem)
    problem, solution, added = solved(problem, job.effects)
    return report(problem, (solution, added), mirror, requested)


def diagnosed(job: Job[Settings, Files]) -> AdjustedJob:
    """Return the best fit in the form that diagnosis needs, with the noise that its residuals show where none is given.

    Raises the errors of `run`, InputError without nominal points, and UndeterminedError without degrees of freedom.
    """
    if job.files.stations:
        raise InputError(
            "several stations at once cannot be diagnosed: `run` names the points that do not fit. To seek a cause, "
            "lay one station onto the points of another"
        )
    if job.files.nominal is None:
        raise InputError("only a best fit can be diagnosed: this job has no `nominal` points")
    problem = _started(problem_of(job.settings, job.files))
    _of_the_mirror_image(problem)
    problem, solution, added = solved(problem, job.effects)
    if solution.dof <= 0:
        raise UndeterminedError("there are no more readings than unknowns: no residual can show an error of the model")
    if problem.estimated:
        found = problem.found if problem.weighed else max(solution.sigma0 * problem.start_noise, problem.rounding)
        problem, solution, added = solved(replace(problem, noise=found), job.effects)
    return adjusted_job(replace(problem.model(), blocks=solution.blocks, groups=solution.groups, added=added))


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError that lists the faults of both lists, without computing."""
    refuse_nothing_to_do(job.settings, job.files)
    if job.files.stations:
        _of_stations(job)
        return
    requested_features(job.settings.features, table_of(job.files.points), "points")
    if job.files.nominal is None:
        _without_effects(job)
    else:
        problem_of(job.settings, job.files)


def solved(
    problem: PointPairs, requests: Sequence[RequestedEffect] = ()
) -> tuple[PointPairs, Solution, tuple[Added, ...]]:
    """Return the problem with the noise that it shows where that is also a weight, its adjustment, and its effects.

    Raises InputError for effects that cannot act, UndeterminedError or NotConvergedError if it has no good solution.
    """

    def renewed(state: PointPairs, reached: tuple[Solution, tuple[Added, ...]]) -> tuple[PointPairs, bool]:
        if not state.weighed:
            return state, False
        noise = noise_of(state, reached[0])
        if abs(noise / state.start_noise - 1) <= _SETTLED:
            return state, False
        return replace(state, found=noise), True

    state, (solution, added) = in_rounds(problem, lambda state: _adjusted(state, requests), renewed)
    return state, solution, added


def _adjusted(problem: PointPairs, requests: Sequence[RequestedEffect]) -> tuple[Solution, tuple[Added, ...]]:
    model = with_all(problem.model(), requests)
    solution = adjust(model.blocks.values(), model.groups)
    if solution.undetermined or not solution.outcome.good:
        lines = [f"  undetermined: {combination}" for combination in solution.undetermined[:3]]
        text = "\n".join([f"{solution.outcome.value}: {solution.observations} readings", *lines])
        if solution.undetermined:
            help = "\n  what would determine it: three points that are not on a line, or more of their coordinates"
            raise UndeterminedError(text + help, solution.misfit)
        raise NotConvergedError(text, solution.misfit)
    return solution, model.added


def _without_effects(job: Job[Settings, Files]) -> None:
    """Raise InputError if a job of features alone requests effects."""
    if job.effects:
        raise InputError(
            f"{keys_of(job.effects)}: only a best fit can have them: leave them out, or add `nominal` points"
        )


def _of_stations(job: Job[Settings, Files]) -> PointPairs:
    if job.effects:
        keys = keys_of(job.effects)
        raise InputError(f"{keys}: they are for the points of one station: leave them out, or the column 'station'")
    return stations_of(job.settings, job.files)


def _started(problem: PointPairs) -> PointPairs:
    """Return the points of one station with its start."""
    whole = len(problem.full) == len(problem.names)
    pose, scale = (similarity if whole else aligned_start)(problem.measured, problem.nominal, problem.scale)
    return replace(problem, start=(pose[None], np.array([scale])))


def _of_the_mirror_image(problem: PointPairs) -> float:
    """Return the root mean square deviation of the mirror image [mm], nan where not all coordinates are used.

    Raises InputError if it is far smaller, or if it is with two names exchanged.
    """
    if problem.joins is not None or len(problem.full) < len(problem.names):
        return float("nan")
    return mirrored(problem.measured, problem.nominal, problem.names, problem.scale)


TASK = Task(Files, run, check, diagnosed=diagnosed, effects=EFFECTS, places=PLACES, covariates=covariates)
