"""The functions of fit-part."""

from __future__ import annotations

from metrocli.result import Result
from metrocli.tasks.fit_part.report import checked, report
from metrocli.tasks.fit_part.settings import Files, Settings
from metrocli.tasks.fit_part.solve import prepare, solve
from metrocli.tasks.job import Job, Task


def run(job: Job[Settings, Files]) -> Result:
    """Return the fitted part; raises InputError, UndeterminedError or NotConvergedError."""
    settings = job.settings
    solved = solve(settings, prepare(settings, job.files.nominal, job.files.points))
    wanted = settings.monte_carlo
    check = None
    if wanted is not None:
        check = checked(solved, settings.overstock.minimum, wanted.trials, wanted.seed)
    return report(solved, check)


def check(job: Job[Settings, Files]) -> None:
    """Raise InputError that lists the faults of points and ideal part together, without computing."""
    prepare(job.settings, job.files.nominal, job.files.points)


TASK = Task(Files, run, check)
