"""Mistakes in the files and settings of a job: a wrong unit, swapped, mirrored or turned axes, another chain.

Each correction is tried by an adjustment with it. They are tried only if a job fails, or if its result is beyond
anything that an effect causes (decision 019); other settings also where no declared noise shows a bad fit (decision
134). `diagnose` continues with the corrected job; a task refuses the file (decision 058).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from functools import partial
from typing import TypeVar

import numpy as np

from metrocli import units
from metrocli.diagnosis.adjusted_job import ABSURD, BETTER, AdjustedJob, Misfit, misfit_of
from metrocli.diagnosis.corrections import ROWS, Inputs, Mistake, corrections
from metrocli.diagnosis.other_settings import with_other_setting
from metrocli.diagnosis.trials import FAILURES, MOST_ROWS, Mistaken, Others, Trial, adjusted_trials, no_others
from metrocli.doubt import MANY_LEFT_OUT
from metrocli.errors import Fault, InputError, MetrocliError, NoSolutionError
from metrocli.table import Table

_AS_GOOD = 2.0
"""Corrections up to so many times as far from the plausible as the best one are reported with it"""
_FAR_BETTER = 1000.0
"""A file is refused if another reading of it makes the squared misfit so many times smaller"""
_FITS = 0.3
"""Where the file as it stands has no solution, another reading must be so near the plausible: residuals of 3 sigma"""
_SUSPECT_PLACES = 0.2
"""Share of the implausible distance of places from their lists above which other readings of the files are tried"""
_USUAL = 10.0, 2e5
"""Distances of instruments of this program [mm]; those of readings of another sort are unusual in every unit"""
Adjust = Callable[[Inputs], AdjustedJob]
T = TypeVar("T", AdjustedJob, Misfit)

ELSEWHERE = Mistake(
    "lists of places", "places lie farther from those that the files list than is plausible", "the rows in their order"
)


def without_mistakes(
    inputs: Inputs,
    adjust: Adjust,
    others: Others = no_others,
    unplaced: Collection[str] = (),
    cleared: Adjust | None = None,
) -> tuple[AdjustedJob, Mistaken | None]:
    """Return the adjusted job, and the mistake without which it was adjusted, if there is one.

    Corrections are tried if the job fails or is absurd. `cleared` adjusts it without outliers: where it is plausible
    then, and these are too few to have one cause, none is tried. Where a failure names what is wrong, and the rest
    fits, only corrections of rows are tried. If none explains a failure, the job is returned without its outliers,
    however many. If that fails too, the exception is raised.
    """
    job, failure = _attempted(adjust, inputs)
    misfits = Misfit(np.inf, np.inf, np.inf) if job is None else misfit_of(job)
    # a plausible job may still have another chain, which the readings show without being absurd
    if job is not None and misfits.worst <= 1:
        better = with_other_setting(job, others)
        return (job, None) if better is None else (better.job, better)
    rest, as_the_task = (None, None) if cleared is None else _attempted(cleared, inputs)
    failure = failure and (as_the_task or failure)
    if rest is not None and rest.left_out < MANY_LEFT_OUT and misfit_of(rest).worst <= 1:
        return rest, None
    corrected = _corrected(_readings_of(inputs, adjust, others, unplaced, failure), misfits, failure)
    if corrected is not None:
        return corrected.job, corrected
    job = job or rest
    if job is None:
        raise failure or RuntimeError("a job that gave nothing")
    # the median that is absurd does not show what one source of several spoils
    better = with_other_setting(job, others)
    if better is not None and misfit_of(better.job).worst <= 1:
        return better.job, better
    if misfits.residuals < 1 < misfits.places:
        # readings that fit places which no list has: no unit and no axis mends that
        return job, Mistaken((ELSEWHERE,), job, misfits.worst, misfits.worst)
    return job, None


def _attempted(adjust: Adjust, inputs: Inputs) -> tuple[AdjustedJob | None, MetrocliError | None]:
    """Return the adjusted job, or the error with which it ends."""
    try:
        return adjust(inputs), None
    except FAILURES as error:
        return None, error


def _corrected(trials: Iterable[Trial], before: Misfit, failure: MetrocliError | None) -> Mistaken | None:
    """Return the corrections with which a job is plausible, and far better than before; None without any."""
    rows_alone = isinstance(failure, NoSolutionError) and not _unexplained(failure)
    tried = [
        (misfit.worst, mistake, other)
        for mistake, misfit, other in adjusted_trials(
            trial for trial in trials if not rows_alone or trial[0].sort == ROWS
        )
        if misfit.worst <= 1
        and misfit.worst * BETTER <= before.worst * mistake.shrinks
        and not before.spoilt_alike(misfit, mistake.shrinks)
    ]
    if not tried:
        return None
    # of equals the likeliest is taken
    (after, _, best), *_ = alike = _as_good(tried)
    return Mistaken(tuple(mistake for _, mistake, _ in alike), best, before.worst, after)


def _readings_of(
    inputs: Inputs, adjust: Adjust, others: Others, unplaced: Collection[str], failure: MetrocliError | None
) -> Iterator[tuple[Mistake, Callable[[], AdjustedJob]]]:
    """Yield each possible mistake, with what adjusts the job without it: first those that the kind of job knows.

    Where the failure names inputs that fail whatever the others contain, no correction of these others is tried.
    """
    # settings first: one that leaves only noise settles what else is tried
    yield from others(np.inf)
    failing = failure.inputs if isinstance(failure, NoSolutionError) else ()
    for mistake, changed in corrections(inputs, unplaced):
        if not failing or mistake.input in failing:
            yield mistake, partial(adjust, changed)


def suspicious(sigma0: float, list_offset: float) -> bool:
    """Return whether a result is so far from plausible that other readings of its files are worth a try."""
    return sigma0 > ABSURD or list_offset > _SUSPECT_PLACES


def misread(
    inputs: Inputs,
    adjust: Adjust,
    failure: MetrocliError | None = None,
    others: Others = no_others,
    unplaced: Collection[str] = (),
) -> InputError | None:
    """Return the refusal of a file that fits a thousand times better if it is read in another way, or None.

    `failure` is the error with which the job ended, if it did; `unplaced` as for `corrections`. Nothing is tried for
    errors that name a line or what to write, since they are explanations, and for readings that fit or are too few: no
    heading causes that. Rows whose numbers are of another size explain more than such a hint.
    """
    tables = [table for table in inputs.values() if isinstance(table, Table)]
    explained = failure is not None and not _unexplained(failure)
    if sum(map(len, tables)) > MOST_ROWS or (explained and not isinstance(failure, InputError)):
        return None
    before = None
    if failure is None:
        before = misfit_of(adjust(inputs))
        if before.residuals < 1 and before.places < _SUSPECT_PLACES:
            return None
    trials: Iterable[Trial] = _readings_of(inputs, adjust, no_others if explained else others, unplaced, failure)
    if explained:
        trials = (trial for trial in trials if trial[0].sort == ROWS)
    misfits = [
        (misfit.worst, mistake, misfit) for mistake, misfit, job in adjusted_trials(trials) if _explains(misfit, job)
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
        "with this corrected, the job has a solution that fits, which it does not have as it stands "
        f"({_first_line(failure)})"
        if before is None
        else f"with this corrected, the readings fit {units.two_digits(before.ratio(fits))} times better "
        "(ratio of squared misfits)"
    )
    also = f"; as good: {'; '.join(rest)}" if rest else ""
    return InputError([Fault(f"{first.words}: {how}", first.file or first.input, hint=f"write {first.write}{also}")])


def _as_good(tried: list[tuple[float, Mistake, T]]) -> list[tuple[float, Mistake, T]]:
    """Return the mistakes that explain a job about as well as the best one, the likeliest first.

    Distances of a usual size are likelier than others, metres or inches under a heading in mm than um, and few columns
    than many.
    """
    # what a wrong correction leaves out as outliers no longer contradicts it
    fewest = min(trial[2].left_out for trial in tried)
    tried = [trial for trial in tried if trial[2].left_out <= max(_AS_GOOD * fewest, _AS_GOOD)]
    best = min(value for value, _, _ in tried)
    # residuals below 2 sigma all fit, and which of them fit best is chance
    alike = [trial for trial in tried if trial[0] <= max(_AS_GOOD * best, _AS_GOOD / ABSURD)]
    near, far = _USUAL
    unusual = [not near <= trial[2].reach <= far for trial in alike]
    # three digits: of solutions that differ by rounding the one that was tried first stays first
    order = sorted(
        zip(unusual, alike, strict=True),
        key=lambda t: (t[0], -t[1][1].shrinks, t[1][1].columns, float(f"{t[1][0]:.3g}")),
    )
    return [trial for _, trial in order]


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
    text = failure.faults[0].message if isinstance(failure, InputError) else str(failure or "")
    return text.partition("\n")[0].removeprefix("error: ")
