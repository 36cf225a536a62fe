"""Mistakes in the files and settings of a job: a wrong unit, swapped, mirrored or turned axes, another chain.

Each correction is tried by an adjustment with it. They are tried only if a job fails, or if its result is beyond
anything that an effect causes (decision 019); other settings also where no declared noise shows a bad fit (decision
134). `diagnose` continues with the corrected job; a task refuses the file (decision 058).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import TypeVar

import numpy as np

from metrocli.adjust.allowance import allowance
from metrocli.adjust.dense_jacobian import least_square, unit_noise
from metrocli.adjust.model.blocks import Array
from metrocli.adjust.probabilities import f_tail
from metrocli.diagnosis.adjusted_job import ABSURD, BETTER, AdjustedJob, Misfit, misfit_of
from metrocli.diagnosis.corrections import Inputs, Mistake, corrections
from metrocli.effects.model import Model
from metrocli.errors import Fault, InputError, MetrocliError, NoSolutionError, NotConvergedError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.table import Table

_AS_GOOD = 2.0
"""Corrections up to so many times as far from the plausible as the best one are reported with it"""
_FAR_BETTER = 1000.0
"""A file is refused if another reading of it makes the squared misfit so many times smaller"""
_FITS = 0.3
"""Where the file as it stands has no solution, another reading must be so near the plausible: residuals of 3 sigma"""
_AS_NOISE = 0.15
"""Where another reading of the files is so near the plausible, no further one is looked for"""
_SUSPECT_PLACES = 0.2
"""Share of the implausible distance of places from their lists above which other readings of the files are tried"""
_MOST_ROWS = 20_000
"""Jobs with more rows are not tried by a task, since each try is an adjustment"""
_OTHER_FITS = 2.0
"""Another setting is reported if it makes the squared residuals so many times smaller, or with fewer unknowns any"""
_SURELY = 1.05
"""A least mean square that is so many times what would do rules an adjustment out: it is known to a few thousandths"""
_MOST_FITTING = 5_000
"""Other settings of a job that fits are tried up to so many readings"""
_BY_CHANCE = 1e-4
"""Level of the F test that they are smaller by chance"""
_LARGER_NOISE = 2.0
"""Root mean square of the residuals in declared standard deviations, up to which they fit"""
FAILURES = (UndeterminedError, NotConvergedError, InputError)

Adjust = Callable[[Inputs], AdjustedJob]
T = TypeVar("T")
Others = Callable[..., Iterable[tuple[Mistake, Callable[[], AdjustedJob]]]]
"""Takes whether the job fits, and perhaps which models are hopeless (`Task.others`); returns what may be wrong in its
settings, each with what adjusts the job without it"""


@dataclass(frozen=True)
class Mistaken:
    """The mistakes that explain the state of a job, the best first, and the job after the correction of that one."""

    mistakes: tuple[Mistake, ...]
    job: AdjustedJob
    before: float
    """`misfit_ratio` of the job with the mistake, inf if it failed"""
    after: float


ELSEWHERE = Mistake(
    "lists of places", "places lie farther from those that the files list than is plausible", "the rows in their order"
)


def no_others(*how: object) -> tuple[()]:
    """Return no other settings."""
    return ()


def without_mistakes(inputs: Inputs, adjust: Adjust, others: Others = no_others) -> tuple[AdjustedJob, Mistaken | None]:
    """Return the adjusted job, and the mistake without which it was adjusted, if there is one.

    Corrections are tried if the job fails or is absurd. If none explains that, the exception of the job as it is is
    raised.
    """
    failure: Exception | None = None
    job, misfits, before = None, Misfit(np.inf, np.inf, np.inf), np.inf
    try:
        job = adjust(inputs)
        misfits = misfit_of(job)
        before = misfits.worst
    except FAILURES as error:
        failure = error
    # a plausible job may still have another chain, which the readings show without being absurd
    if job is not None and before <= 1:
        better = with_other_setting(job, others)
        return (job, None) if better is None else (better.job, better)
    tried = [
        (misfit.worst, mistake, other)
        for mistake, misfit, other in _tried(_readings_of(inputs, adjust, others))
        if misfit.worst <= 1
        and misfit.worst * BETTER <= before * mistake.shrinks
        and not misfits.spoilt_alike(misfit, mistake.shrinks)
    ]
    if tried:
        alike = _as_good(tried)
        # of equals the likeliest is taken
        after, _, best = alike[0]
        return best, Mistaken(tuple(mistake for _, mistake, _ in alike), best, before, after)
    if job is None:
        raise failure or RuntimeError("a job that gave nothing")
    # readings that fit places which no list has: no unit and no axis mends that
    return job, Mistaken((ELSEWHERE,), job, before, before) if misfits.residuals < 1 < misfits.places else None


def with_other_setting(job: AdjustedJob, others: Others) -> Mistaken | None:
    """Return the setting with which the readings of an adjusted job fit best, if they fit far better than with its own.

    Residuals of all are in the median standard deviations of the job. A common factor of these, as of a noise that
    follows the residuals, does not matter.
    """
    readings = job.model.readings
    size = {group.name: np.median(group.observations.deviations, axis=1) for group in readings}
    # sizes are fixed: an estimated noise would grow with the wrong chain and hide it
    # (docs/decisions/134-other-settings.md)
    before, dof = _mean_square(job, size), _redundant(job)
    fits = before <= _LARGER_NOISE**2
    if sum(group.observations.count for group in readings) > (_MOST_FITTING if fits else _MOST_ROWS):
        return None
    hopeless = partial(_cannot_fit, size=size, most=before / _OTHER_FITS)
    tried = [(_mean_square(other, size), mistake, other) for mistake, _, other in _tried(others(fits, hopeless))]
    if not tried:
        return None
    after, mistake, other = min(tried, key=lambda trial: trial[0])
    ratio = before / max(after, 1e-12)
    # one set of readings gives both squares, which then differ less than the independent ones of an F test
    if (ratio < _OTHER_FITS and _redundant(other) <= dof) or f_tail(dof, dof, ratio) > _BY_CHANCE:
        return None
    return Mistaken((mistake,), other, float(np.sqrt(before)), float(np.sqrt(after)))


def _cannot_fit(begun: Callable[[], Model], size: Mapping[str, Array], most: float) -> bool:
    """Return whether no weights and no values bring the mean square of `_mean_square` down to `most`."""
    try:
        model = begun()
    except FAILURES:
        return False
    units = [unit_noise(group, size[group.name][:, None]) for group in model.readings]
    least = sum(least_square(group, model.blocks) for group in units)
    return least > _SURELY * most * sum(group.observations.readings.size for group in units)


def _mean_square(job: AdjustedJob, size: Mapping[str, Array]) -> float:
    """Return the mean square of the residuals of a job, each over the size of its component."""
    rows = [group.residuals(job.model.blocks) / size[group.name][:, None] for group in job.model.readings]
    return float(np.mean(np.concatenate([row.ravel() for row in rows]) ** 2))


def _redundant(job: AdjustedJob) -> int:
    """Return the number of rows beyond the unknowns, at least 1."""
    rows = sum(group.residuals(job.model.blocks).size for group in job.model.groups)
    return max(rows - sum(int(block.free.sum()) for block in job.model.blocks.values()), 1)


def misfit_ratio(job: AdjustedJob) -> float:
    """Return how far a job is beyond the plausible: by its median residual, or by its places compared with the files.

    Above 1 it is absurd.
    """
    return misfit_of(job).worst


def _readings_of(inputs: Inputs, adjust: Adjust, others: Others) -> Iterator[tuple[Mistake, Callable[[], AdjustedJob]]]:
    """Yield each possible mistake, with what adjusts the job without it: first those that the kind of job knows."""
    # settings first: one that leaves only noise settles what else is tried
    yield from others(False)
    for mistake, changed in corrections(inputs):
        yield mistake, partial(adjust, changed)


def _tried(
    readings: Iterable[tuple[Mistake, Callable[[], AdjustedJob]]],
) -> Iterator[tuple[Mistake, Misfit, AdjustedJob]]:
    """Yield the corrections with which the job can be adjusted.

    After one that leaves no more than noise, only the same sort of correction is tried, also of the other files.
    Distances do not distinguish a mirrored list of points from a mirrored list of tracers, nor which axis is mirrored.
    Each try is an adjustment.
    """
    settled = ""
    for mistake, adjusted in readings:
        if settled not in ("", mistake.sort):
            continue
        try:
            # readings in a wrong unit wander: without a limit, each of some dozen
            # tries would take as many steps as a job may
            with allowance(mistake.steps):
                job = adjusted()
        except FAILURES:
            continue
        misfit = misfit_of(job)
        # the first sort that leaves only noise stays: further ones of it are as good, and are reported with it
        settled = settled or (mistake.sort if misfit.worst <= _AS_NOISE else "")
        yield mistake, misfit, job


def suspicious(sigma0: float, list_offset: float) -> bool:
    """Return whether a result is so far from plausible that other readings of its files are worth a try."""
    return sigma0 > ABSURD or list_offset > _SUSPECT_PLACES


def misread(
    inputs: Inputs, adjust: Adjust, failure: MetrocliError | None = None, others: Others = no_others
) -> InputError | None:
    """Return the refusal of a file that fits a thousand times better if it is read in another way, or None.

    `failure` is the error with which the job ended, if it did. Nothing is tried for errors that name a line or what to
    write, since they are explanations, and for readings that fit or are too few: no heading causes that.
    """
    tables = [table for table in inputs.values() if isinstance(table, Table)]
    # an error that names a line or what to write explains itself
    if sum(map(len, tables)) > _MOST_ROWS or (failure is not None and not _unexplained(failure)):
        return None
    before = None
    if failure is None:
        before = misfit_of(adjust(inputs))
        if before.residuals < 1 and before.places < _SUSPECT_PLACES:
            return None
    misfits = [
        (misfit.worst, mistake, misfit)
        for mistake, misfit, job in _tried(_readings_of(inputs, adjust, others))
        if _explains(misfit, job)
    ]
    if before is not None:
        misfits = [
            misfit
            for misfit in misfits
            # an effect of an instrument gains far less than a wrong unit or axis
            # costs (docs/decisions/058-refused-lists.md)
            if before.ratio(misfit[2], misfit[1].shrinks) >= _FAR_BETTER
            and misfit[0] <= 1
            and not before.spoilt_alike(misfit[2], misfit[1].shrinks)
        ]
    if not misfits:
        return None
    # a mirrored list of points and one of tracers give the same solution: nothing decides between them
    # (docs/decisions/019-mistakes-are-not-effects.md)
    (_, first, fits), *alike = _as_good(misfits)
    rest = [f"{mistake.file or mistake.input}: {mistake.words}" for _, mistake, _ in alike]
    how = (
        f"read so, the job has a solution that fits, which it has not as it stands ({_first_line(failure)})"
        if before is None
        else f"read so, the readings fit {before.ratio(fits):.2g} times better (ratio of squared misfits)"
    )
    also = f"; as good: {'; '.join(rest)}" if rest else ""
    return InputError([Fault(f"{first.words}: {how}", first.file or first.input, hint=f"write {first.write}{also}")])


def _as_good(tried: list[tuple[float, Mistake, T]]) -> list[tuple[float, Mistake, T]]:
    """Return the mistakes that explain a job about as well as the best one, the likeliest first.

    Metres or inches under a heading in mm are likelier than um; then few columns are likelier than many.
    """
    best = min(value for value, _, _ in tried)
    # residuals below 2 sigma all fit, and which of them fit best is chance
    alike = [trial for trial in tried if trial[0] <= max(_AS_GOOD * best, _AS_GOOD / ABSURD)]
    return sorted(alike, key=lambda trial: (-trial[1].shrinks, trial[1].columns, trial[0]))


def _unexplained(failure: MetrocliError) -> bool:
    if isinstance(failure, InputError):
        return not any(fault.line or fault.hint for fault in failure.faults)
    return isinstance(failure, NoSolutionError) and failure.misfit > ABSURD


def _explains(misfit: Misfit, job: AdjustedJob) -> bool:
    """Return whether a reading of the files fits, with more readings than unknowns."""
    readings = sum(group.residuals(job.model.blocks).size for group in job.model.groups)
    unknowns = sum(int(block.free.sum()) for block in job.model.blocks.values())
    # without a spare reading any reading of the files fits
    return misfit.worst <= _FITS and readings > unknowns


def _first_line(failure: MetrocliError | None) -> str:
    return str(failure).splitlines()[0].removeprefix("error: ") if failure is not None else ""
