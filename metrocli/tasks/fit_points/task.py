"""The functions of fit-points."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.solution import Solution
from metrocli.errors import InputError, NotConvergedError, UndeterminedError
from metrocli.result import Result
from metrocli.tasks.fit_points.features import features_alone
from metrocli.tasks.fit_points.problem import PointPairs, problem_of
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
    return report(problem, solved(problem), mirrored, wanted)


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError that lists the faults of both lists, without computing."""
    wanted_features(job.settings.features, job.files.points, "points")
    if job.files.nominal is not None:
        problem_of(job.settings, job.files)


def solved(problem: PointPairs) -> Solution:
    """Return the adjustment; raises UndeterminedError or NotConvergedError if it has no good solution."""
    if len(problem.full) == len(problem.names):
        pose, scale = similarity(problem.measured, problem.nominal, problem.scale)
    else:
        pose, scale = aligned_start(problem.measured, problem.nominal, problem.scale)
    blocks = problem.blocks(pose, scale)
    solution = adjust(blocks.values(), problem.groups(blocks))
    if solution.undetermined or not solution.outcome.good:
        lines = [f"  undetermined: {combination}" for combination in solution.undetermined[:3]]
        text = "\n".join([f"{solution.outcome.value}: {solution.observations} readings", *lines])
        if solution.undetermined:
            help = "\n  what would determine it: three points that are not on a line, or more of their coordinates"
            raise UndeterminedError(text + help, solution.misfit)
        raise NotConvergedError(text, solution.misfit)
    return solution


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


TASK = Task(Files, run, check)
