"""The whole diagnosis of one adjusted job, from its linearised system to the verdict.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace

import numpy as np

from metrocli.diagnosis.adjusted_job import AdjustedJob, Budget, Ordered
from metrocli.diagnosis.cross_validation import Gain, cross_validated
from metrocli.diagnosis.detectability import Design, design
from metrocli.diagnosis.extended_fit import (
    readings_kept,
    result_changes,
    score_tests_after,
    score_tests_of_job,
    sizes,
)
from metrocli.diagnosis.findings import Diagnosis, Finding
from metrocli.diagnosis.fit_of_names import FitOfNames
from metrocli.diagnosis.laws.imitations import without_imitations
from metrocli.diagnosis.laws.library import Library
from metrocli.diagnosis.laws.scatter_beside import explains_scatter, without_scatter
from metrocli.diagnosis.laws.search import Law, laws_in
from metrocli.diagnosis.linear.fitted_columns import nothing_fitted
from metrocli.diagnosis.linear.memory import as_fits
from metrocli.diagnosis.linear.projection import System
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.linear.signatures import signature
from metrocli.diagnosis.noise import noise_as_likely, noise_of
from metrocli.diagnosis.power.alike import separations
from metrocli.diagnosis.residual_structure import (
    REPEATS,
    PureError,
    RemainingStructure,
    log_level_of_strongest,
    other_shape_from,
    pure_error,
    remaining_structure,
)
from metrocli.diagnosis.searched import SEED, Searched, search_about_solution, with_scatters
from metrocli.diagnosis.selection.confidence_set import NamedEffect, confidence_sets
from metrocli.diagnosis.smooth_errors.process import Process
from metrocli.diagnosis.wrong_readings import wrong_readings
from metrocli.progress import SILENT, Progress

Attended = Callable[[Callable[[], None]], AbstractContextManager[object]]
"""Takes what interrupts a search, and calls it if the user wants that within the context"""
_PROCESS = 0.005
"""Level below which a smooth process is reported as structure"""
_LACK_OF_FIT = 0.005
"""Level of the lack-of-fit test of repeated readings below which structure is reported"""
LIMIT = 120.0
"""CPU time for all searches [s]"""
_OF_EFFECTS = 0.75
"""Share of it that the search of effects may take at most"""


def no_interrupt(heeded: Callable[[], None]) -> AbstractContextManager[object]:
    """Return a context in which nobody interrupts."""
    return nullcontext()


def diagnose(
    job: AdjustedJob,
    progress: Progress = SILENT,
    limit: float = LIMIT,
    attended: Attended = no_interrupt,
    ordered: Ordered = map,
) -> Diagnosis:
    """Return the diagnosis of an adjusted job; its searches take at most `limit` [s of CPU time].

    The search of effects has three quarters of it, the searches of cross-validation what that leaves. A search whose
    time is spent ends with what it has found; so does that for laws when its budget is interrupted within `attended`.
    `ordered` computes the folds of cross-validation, perhaps on other processors; the diagnosis is the same there.
    Raises UndeterminedError if the unknowns use up all readings, InputError if it needs more memory than there is.
    """
    job = replace(as_fits(job), budget=Budget(_OF_EFFECTS * limit))
    found = _diagnosed_again_if_suspect(job, progress, limit, attended, ordered)
    # what to measure needs systems of its own, of many readings large ones: those of the search are gone by now
    return replace(found, separate_by=_separate(found.job, [one.effect for one in found.findings]))


def _diagnosed_again_if_suspect(
    job: AdjustedJob, progress: Progress, limit: float, attended: Attended, ordered: Ordered
) -> Diagnosis:
    """Return the diagnosis of a job, or that without a noise that stands for a law or an effect."""

    def diagnosed(job: AdjustedJob) -> tuple[Diagnosis, Searched]:
        return _diagnosed(job, progress, limit, attended, ordered)

    found, _ = diagnosed(job)
    units, scattered = found.noisier_units, [one.found.effect.name for one in found.scatters]
    suspect = found.law is not None or _in_noisy_unit(found)
    plain = without_scatter(job, units, scattered) if suspect and not found.interrupted else None
    if plain is None:
        return found
    progress.doing("diagnosing again without the noise that may stand for a law or an effect", job.budget.left())
    again, searched = diagnosed(plain)
    explains = explains_scatter(again.law, job, searched.selection, units, scattered)
    return again if explains and (again.law is not None or again.findings) else found


def _in_noisy_unit(found: Diagnosis) -> bool:
    """Return whether an effect was found at a unit whose noise was taken for larger before."""
    noisy = {(unit.key, unit.name) for unit in found.noisier_units}
    return any(noisy & set(one.effect.alternative.where.items()) for one in found.findings)


def _diagnosed(
    job: AdjustedJob, progress: Progress, limit: float, attended: Attended, ordered: Ordered
) -> tuple[Diagnosis, Searched]:
    """Return the diagnosis of a job within its budget, and the search from which it follows."""
    progress.doing("looking for structure", job.budget.left())
    first = search_about_solution(job, progress)
    job, searched, scatters = with_scatters(job, first, progress)
    searched, library = _without_imitations(job, searched)
    white = searched.beside_white_noise
    names = confidence_sets(searched.selection)
    left = (1 - _OF_EFFECTS) * limit + max(job.budget.left(), 0.0)
    progress.doing("cross-validating: predicting parts of the readings from the others", left)
    gains = cross_validated(searched.job, searched.selection, names, left, ordered) if names else []
    kept = readings_kept(searched.selection)
    fit = (searched.of_names.or_of if searched.of_names else FitOfNames.of)(job, names, kept).fit
    shifts = result_changes(job, names, fit, kept)
    tests, fitted = score_tests_after(fit, white, names, searched.units, np.random.default_rng(SEED))
    structure, level = remaining_structure(white, names, tests, fitted)
    repeats = pure_error(job, tests.system, fitted)
    structure = structure or _structure_of_repeats(repeats)
    laws: tuple[Law, ...] = ()
    if job.places:
        progress.doing("looking for a law in what no effect explains", job.budget.left())
        with attended(job.budget.interrupt):
            # beside a process, which explains the structure, a law has to show as one does without structure
            laws = laws_in(library, searched.selection, bool(structure and not searched.processes), ordered)
    before = _strongest_before(first.beside_white_noise.test_set)
    structure = structure or _structure_of(laws) or _structure_of_processes(searched.processes, before)
    # without an extended fit and processes the law is about the same linearised system; what it explains is no noise
    law = next((one for one in laws if one.chosen and fit is None and not searched.processes), None)
    explained = fitted.with_columns(law.columns) if law else fitted
    # what a process explains is structure, and is in the tests: only the white part beside it is noise
    noise = noise_of(searched.selection.fitted() if searched.processes else explained)
    findings = tuple(_findings(job, searched, zip(names, gains, shifts, strict=False), tests, noise.ratio))
    # of many readings their tables are large, and nothing below needs them
    del tests, fitted, explained, library
    progress.doing("computing what the measurement could not detect")
    diagnosis = Diagnosis(
        job=job,
        noise=noise,
        noisier_units=searched.units,
        outliers=wrong_readings(searched.selection),
        findings=findings,
        left=structure,
        before=before,
        after=level,
        design=design(searched.job, searched.tests, searched.not_tested, noise.ratio),
        separate_by=(),
        adjusts=fit is not None or not names,
        together=gains[-1] if len(names) > 1 else None,
        repeats=repeats,
        scatters=scatters,
        laws=laws,
        processes=searched.processes,
        limited=limit if job.budget.ended else None,
        interrupted=job.budget.interrupted,
    )
    return diagnosis, searched


def _without_imitations(job: AdjustedJob, searched: Searched) -> tuple[Searched, Library]:
    """Return the search without names that stand for a law, and the library in which laws are sought after it."""
    white = searched.beside_white_noise
    library = Library(searched.job, white.test_set.system)
    if not job.places:
        return searched, library
    only = without_imitations(library, white, searched.processes)
    searched = searched if only is None else searched.with_white_noise(only)
    if searched.processes:
        library = Library(searched.job, searched.selection.test_set.system)
    return searched, library


def _findings(
    job: AdjustedJob,
    searched: Searched,
    named: Iterable[tuple[NamedEffect, Gain, float | None]],
    tests: ScoreTests,
    noise: float,
) -> Iterator[Finding]:
    """Yield the findings of named effects, with the gain of each and the change of the result in the extended fit."""
    for name, gain, shift in named:
        change = _linear_change(searched.job, searched.tests.system, name) if shift is None else shift
        as_likely = noise_as_likely(searched.job, searched.selection, name.chosen)
        yield Finding(name, sizes(job, name), gain, change, other_shape_from(name, tests, noise), as_likely)


def _structure_of_repeats(repeats: PureError | None) -> RemainingStructure | None:
    """Return the structure that repeated readings show by their lack of fit."""
    if repeats is None or repeats.lack_of_fit >= _LACK_OF_FIT:
        return None
    return RemainingStructure(repeats.lack_of_fit, (REPEATS,))


def _strongest_before(tests: ScoreTests) -> float:
    return float(np.exp(log_level_of_strongest(tests, nothing_fitted(tests.system))))


def _structure_of_processes(processes: Sequence[Process], before: float) -> RemainingStructure | None:
    """Return the structure that smooth processes are, where smooth functions show none.

    Where a process stands instead of effects, white noise alone does not explain the readings: its level is `before`.
    """
    strongest = min(processes, key=lambda one: (not one.instead_of, one.log_level), default=None)
    if strongest is None or not (strongest.instead_of or strongest.log_level < np.log(_PROCESS)):
        return None
    level = float(np.exp(strongest.log_level))
    level = min(level, before) if strongest.instead_of else level
    return RemainingStructure(level, (strongest.covariate,), (), 0.0)


def _structure_of(laws: Sequence[Law]) -> RemainingStructure | None:
    """Return the structure that a law shows where smooth functions show none."""
    law = next((one for one in laws if one.chosen), None)
    if law is None:
        return None
    names = dict.fromkeys(name for term in law.terms for name in term.form.variables)
    return RemainingStructure(law.p_value, tuple(names), tuple(name for _, name in law.terms[0].spot.where), law.size)


def what_can_be_seen(job: AdjustedJob) -> Design:
    """Return what a measurement can detect; it does not depend on the residuals.

    Raises InputError if this needs more memory than there is.
    """
    job = as_fits(job)
    test_set, not_tested = score_tests_of_job(job, {}, np.random.default_rng(SEED))
    return design(job, test_set, not_tested)


def _linear_change(job: AdjustedJob, system: System, name: NamedEffect) -> float:
    """Return the largest change of the delivered result by an effect, to first order."""
    alternative = name.alternative
    full = signature(job.model, system, alternative.effect, alternative.instance, dict(alternative.scanned))
    change = (full @ name.values)[:, None]
    shift = job.delivered.of(lambda block: system.shift(change, block, job.delivered.columns))
    return float(np.sqrt((shift**2).sum(axis=(1, 2)).max(initial=0.0)))


def _separate(job: AdjustedJob, names: Sequence[NamedEffect]) -> tuple[str, ...]:
    """Return, in words, what to measure to distinguish the named effects from their best rivals."""
    pairs = [(name.alternative, rival.alternative) for name in names for rival in name.rivals[:2]]
    return tuple(dict.fromkeys(words for found in separations(job, pairs) for words in found)) if pairs else ()
