"""Trials of corrections: each adjusts a job without one possible mistake in its files or settings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from metrocli import units
from metrocli.adjust.allowance import allowance
from metrocli.diagnosis.adjusted_job import AdjustedJob, Misfit, misfit_of
from metrocli.diagnosis.corrections import Mistake
from metrocli.errors import InputError, NotConvergedError, UndeterminedError
from metrocli.frozen import dataclass

MOST_ROWS = 20_000
"""Jobs with more rows are not tried by a task, since each try is an adjustment"""
_AS_NOISE = 0.15
"""Where another reading of the files is so near the plausible, no further one is looked for"""
FAILURES = (UndeterminedError, NotConvergedError, InputError)

Trial = tuple[Mistake, Callable[[], AdjustedJob]]
"""What may be wrong, with what adjusts the job without it"""
Others = Callable[..., Iterable[Trial]]
"""Takes sigma0, the number of readings left out, and which models are hopeless (`Task.others`); returns what may be
wrong in the settings"""


@dataclass(frozen=True)
class Mistaken:
    """The mistakes that explain the state of a job, the best first, and the job after the correction of that one."""

    mistakes: tuple[Mistake, ...]
    job: AdjustedJob
    before: float
    """`Misfit.worst` of the job with the mistake, inf if it failed"""
    after: float
    left_out: int = 0
    """Readings that the job with the mistake left out as outliers"""

    @property
    def mended(self) -> bool:
        """Whether the job fits better after the correction, or leaves out fewer readings."""
        return self.after < self.before or self.job.left_out < self.left_out

    @property
    def gain(self) -> str:
        """What the correction of the first mistake gains, in words."""
        gains = []
        if self.after < self.before:
            ratio = units.two_digits((self.before / max(self.after, 1e-12)) ** 2)
            gains.append(f"the squared residuals are {ratio} times smaller")
        if self.job.left_out < self.left_out:
            gains.append(f"the readings left out as outliers are {self.job.left_out}, not {self.left_out}")
        return " and ".join(gains)


def no_others(*how: object) -> tuple[()]:
    """Return no other settings."""
    return ()


def adjusted_trials(trials: Iterable[Trial]) -> Iterator[tuple[Mistake, Misfit, AdjustedJob]]:
    """Yield the corrections with which the job can be adjusted.

    After one that leaves no more than noise, only the same sort of correction is tried, also of the other files.
    Distances do not distinguish a mirrored list of points from a mirrored list of tracers, nor which axis is mirrored.
    Of corrections that are alike one is tried, if it is in vain. Each trial is an adjustment.
    """
    settled, vain = "", set[str]()
    for mistake, adjusted in trials:
        if settled not in ("", mistake.sort) or mistake.alike in vain:
            continue
        try:
            # readings in a wrong unit wander: without a limit, each of some dozen
            # trials would take as many steps as a job may
            with allowance(mistake.steps):
                job = adjusted()
        except FAILURES:
            vain |= {mistake.alike} - {""}
            continue
        misfit = misfit_of(job)
        if misfit.worst > 1:
            vain |= {mistake.alike} - {""}
        # the first sort that leaves only noise stays: further ones of it are as good, and are reported with it
        settled = settled or (mistake.sort if misfit.worst <= _AS_NOISE else "")
        yield mistake, misfit, job
