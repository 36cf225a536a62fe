"""The whole diagnosis of one adjusted job, from its linearised system to the verdict.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob, Budget, Ordered
from metrocli.diagnosis.cross_validation import cross_validated, gain_of_model
from metrocli.diagnosis.detectability import Design, design, separations
from metrocli.diagnosis.extended_fit import (
    extended_fit,
    readings_kept,
    relinearised,
    result_change,
    result_changes,
    score_tests_after,
    score_tests_of_job,
    sizes,
    weights_of,
    with_scatter,
)
from metrocli.diagnosis.findings import Diagnosis, Finding, Scatter
from metrocli.diagnosis.laws.imitations import without_imitations
from metrocli.diagnosis.laws.library import Library
from metrocli.diagnosis.laws.search import Law, laws_in
from metrocli.diagnosis.linear.candidates import NotTested
from metrocli.diagnosis.linear.fitted_columns import FittedColumns, nothing_fitted
from metrocli.diagnosis.linear.projection import System
from metrocli.diagnosis.linear.random_columns import beside_random_columns
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.linear.signatures import signature
from metrocli.diagnosis.noise import DECLARED_SIGMA, READING, Unit, noise_of, noisiest_unit, reweighted
from metrocli.diagnosis.processes import Process, process_in
from metrocli.diagnosis.residual_structure import (
    REPEATS,
    RemainingStructure,
    log_level_of_strongest,
    other_shape_from,
    pure_error,
    remaining_structure,
)
from metrocli.diagnosis.selection.all_of_a_kind import AllOfAKind, all_of_a_kind, estimated_again, scattered_throughout
from metrocli.diagnosis.selection.confidence_set import NamedEffect, confidence_sets
from metrocli.diagnosis.selection.refined_scan import refined_scans
from metrocli.diagnosis.selection.search import continued, search, transferred
from metrocli.diagnosis.selection.selection_state import Selection
from metrocli.diagnosis.selection.thresholds import has_dominant_effect
from metrocli.diagnosis.wrong_readings import wrong_readings
from metrocli.errors import UndeterminedError

Say = Callable[[str], None]
Attended = Callable[[Callable[[], None]], AbstractContextManager[object]]
"""Takes what interrupts a search, and calls it if the user wants that within the context"""
_LACK_OF_FIT = 0.005
"""Level of the lack-of-fit test of repeated readings below which structure is reported"""
_ROUNDS = 3
"""Largest number of noisier units that are reweighted, one after the other"""
_SEARCHES = 5
"""Largest number of searches; each follows an adjustment with the effects that dominated the previous one"""
_PROCESS = 0.005
"""Level below which a smooth process is reported as structure"""
_PROCESSES = 3
"""Largest number of smooth processes that are taken for noise, one after the other"""
_KINDS = 2
"""Largest number of effects that act at all places of a kind"""
_ESTIMATES, _STAYS = 3, float(np.log(1.2))
"""Largest number of searches with such an effect in the model, and the change of ln std that calls for another"""
LIMIT = 120.0
"""CPU time for all searches [s]"""
_SEED = 20


def no_interrupt(heeded: Callable[[], None]) -> AbstractContextManager[object]:
    """Return a context in which nobody interrupts."""
    return nullcontext()


def diagnose(
    job: AdjustedJob,
    say: Say = lambda line: None,
    limit: float = LIMIT,
    attended: Attended = no_interrupt,
    ordered: Ordered = map,
) -> Diagnosis:
    """Return the diagnosis of an adjusted job, with at most half of `limit` [s of CPU time] for the search of effects.

    The other half is for the searches of cross-validation. A search whose time is spent ends with what it has found;
    so does the search for laws when its budget is interrupted within `attended`.
    `ordered` computes the folds of cross-validation, perhaps on other processors; the diagnosis is the same there.
    Raises UndeterminedError if the unknowns use up all readings.
    """
    job = replace(job, budget=Budget(limit / 2))
    say("looking for structure")
    searched = first = _search_about_solution(job, say)
    job, searched, scatters = _with_scatters(job, searched, say)
    white = searched.beside_white_noise
    library = Library(searched.job, white.test_set.system)
    if job.places and not searched.processes:
        searched = replace(searched, selection=without_imitations(library, white))
        white = searched.selection
    names = confidence_sets(searched.selection)
    say("cross-validating: predicting parts of the readings from the others")
    gains = cross_validated(searched.job, searched.selection, names, ordered) if names else []
    kept = readings_kept(searched.selection)
    fit = extended_fit(job, names, kept) if names else None
    shifts = result_changes(job, names, fit, kept)
    tests, fitted = score_tests_after(fit, white, searched.units, np.random.default_rng(_SEED))
    structure, level = remaining_structure(white, names, tests, fitted)
    repeats = pure_error(job, tests.system, fitted)
    if structure is None and repeats is not None and repeats.lack_of_fit < _LACK_OF_FIT:
        structure = RemainingStructure(repeats.lack_of_fit, (REPEATS,))
    laws: tuple[Law, ...] = ()
    if job.places:
        say("looking for a law in what no effect explains")
        with attended(job.budget.interrupt):
            laws = laws_in(library, white, structure is not None, ordered)
        structure = _structure_of(laws) if structure is None else structure
    if structure is None:
        structure = _structure_of_processes(searched.processes)
    # without an extended fit the law is about the same linearised system, and what it explains is no noise
    law = next((one for one in laws if one.chosen and fit is None), None)
    noise = noise_of(fitted if law is None else fitted.with_columns(law.columns))
    # what a process adds to the noise is in the tests, so only the white part counts beside it
    white_part = noise_of(searched.selection.fitted()) if searched.processes else noise
    say("computing what the measurement could not detect")
    return Diagnosis(
        job=job,
        noise=noise,
        noisier_units=searched.units,
        outliers=wrong_readings(searched.selection),
        findings=tuple(
            Finding(
                name,
                sizes(job, name),
                gain,
                _linear_change(searched.job, searched.tests.system, name) if shift is None else shift,
                other_shape_from(name, tests, noise.ratio),
            )
            for name, gain, shift in zip(names, gains, shifts, strict=False)
        ),
        left=structure,
        before=_strongest_before(first.beside_white_noise.test_set),
        after=level,
        design=design(searched.job, searched.tests, searched.not_tested, white_part.ratio),
        separate_by=_separate(job, names),
        adjusts=fit is not None or not names,
        together=gains[-1] if len(names) > 1 else None,
        repeats=repeats,
        scatters=scatters,
        laws=laws,
        processes=searched.processes,
        limited=limit if job.budget.ended else None,
        interrupted=job.budget.interrupted,
    )


def _strongest_before(tests: ScoreTests) -> float:
    return float(np.exp(log_level_of_strongest(tests, nothing_fitted(tests.system))))


def _structure_of_processes(processes: Sequence[Process]) -> RemainingStructure | None:
    """Return the structure that smooth processes are, where smooth functions show none."""
    strongest = min(processes, key=lambda one: one.log_level, default=None)
    if strongest is None or strongest.log_level > np.log(_PROCESS):
        return None
    return RemainingStructure(float(np.exp(strongest.log_level)), (strongest.covariate,), (), strongest.std)


def _structure_of(laws: Sequence[Law]) -> RemainingStructure | None:
    """Return the structure that a law shows where smooth functions show none."""
    law = next((one for one in laws if one.chosen), None)
    if law is None:
        return None
    names = dict.fromkeys(name for term in law.terms for name in term.form.variables)
    return RemainingStructure(law.p_value, tuple(names), tuple(name for _, name in law.terms[0].spot.where), law.size)


def _with_scatters(
    job: AdjustedJob, searched: _Searched, say: Say
) -> tuple[AdjustedJob, _Searched, tuple[Scatter, ...]]:
    """Return the job and the search with effects at all places of a kind in the model, where these explain more."""
    scatters: list[Scatter] = []
    while len(scatters) < _KINDS:
        found = all_of_a_kind(searched.selection) or scattered_throughout(searched.selection)
        if found is None or found.effect.name in {one.found.effect.name for one in scatters}:
            break
        say(f"adjusting with {found.effect.name} at every {found.effect.keys[0]}")
        settled = _with_scatter(job, searched, found, say)
        if settled is None:
            break
        found, wider, after = settled
        gain = gain_of_model(job, _others(searched, found.effect.name), _others(after))
        scatters.append(Scatter(found, gain, result_change(job, wider)))
        job, searched = wider, after
    return job, searched, tuple(scatters)


def _with_scatter(
    job: AdjustedJob, searched: _Searched, found: AllOfAKind, say: Say
) -> tuple[AllOfAKind, AdjustedJob, _Searched] | None:
    """Return a scatter, the job with it in the model, and the search about that; None if it cannot be adjusted.

    Its standard deviation is estimated again beside what the search then finds, until it stays.
    """
    kept, done = readings_kept(searched.selection), None
    for _ in range(_ESTIMATES):
        wider = with_scatter(job, found, kept)
        if wider is None:
            break
        after = _search_about_solution(wider, say)
        done = found, wider, after
        again = estimated_again(found, transferred(after.selection, searched.tests))
        if abs(np.log(again.std / found.std)) < _STAYS:
            break
        found, kept = again, readings_kept(after.selection)
    return done


def _others(searched: _Searched, name: str = "") -> tuple[ScoreTests, FittedColumns]:
    """Return the fit of what was selected, without smooth terms and without the effects of a name."""
    selection = searched.selection
    own = [one for one in selection.named if selection.test_set.families[one.family].name == name]
    return selection.test_set, selection.fitted(without=[*own, *selection.unknown])


@dataclass(frozen=True)
class _Searched:
    """A selection, and the job about whose solution it was linearised."""

    job: AdjustedJob
    tests: ScoreTests
    not_tested: list[NotTested]
    units: tuple[Unit, ...]
    """Units that are noisier than the others and whose readings were given less weight"""
    selection: Selection
    processes: tuple[Process, ...] = ()
    """Smooth random errors that belong to the noise beside which the selection holds"""
    plain: Selection | None = None
    """The same effects beside white noise, with what else explains the readings there; None without a process"""

    @property
    def beside_white_noise(self) -> Selection:
        """The selection beside white noise."""
        return self.selection if self.plain is None else self.plain


def _search_about_solution(job: AdjustedJob, say: Say) -> _Searched:
    """Return the selection, linearised about the job with its dominant effects adjusted (decision 051)."""
    return _with_processes(_search_beside_white_noise(job, say), say)


def _with_processes(searched: _Searched, say: Say) -> _Searched:
    """Return the search repeated beside the smooth processes that the readings show, one after the other."""
    job, tests, selection = searched.job, searched.tests, searched.selection
    plain, processes = selection, list[Process]()
    if all_of_a_kind(selection) is not None or scattered_throughout(selection) is not None:
        # places that are off throughout are a cause; a process of each of them would take it for chance
        return searched
    while len(processes) < _PROCESSES and not job.budget.spent():
        found = process_in(job, selection)
        if found is None:
            break
        say(f"searching beside an error that varies smoothly with {found.covariate}")
        processes.append(found)
        rng = np.random.default_rng(_SEED)
        tests = beside_random_columns(tests, found.columns, rng, job.single_components)
        selection = refined_scans(job, search(tests, nothing_fitted(tests.system)))
    if not processes:
        return searched
    kept = transferred(selection, plain.test_set)
    for one in plain.unknown:
        kept = kept.with_one(one)
    return replace(searched, tests=tests, selection=selection, processes=tuple(processes), plain=kept)


def _search_beside_white_noise(job: AdjustedJob, say: Say) -> _Searched:
    """Return the selection beside white noise, linearised about the job with its dominant effects adjusted.

    If effects dominate, the job is adjusted with them, and the search is repeated about that solution with them among
    all other candidates. At the end the search continues about the job adjusted with all effects that were named.
    """
    point = job
    earlier: ScoreTests | None = None
    for left in reversed(range(_SEARCHES)):
        point = point if left else replace(point, patient=True)
        found = _search_with_weights(point, np.random.default_rng(_SEED), earlier)
        earlier = found.tests
        selection = refined_scans(point, found.selection)
        if not has_dominant_effect(selection):
            break
        say("adjusting with what was found")
        names = confidence_sets(selection)
        fit = extended_fit(job, names, readings_kept(selection))
        point = replace(point, patient=True) if fit is None else relinearised(job, names, fit)
    names = confidence_sets(selection)
    fit = extended_fit(job, names, readings_kept(selection)) if names else None
    if fit is None:
        return replace(found, job=point, selection=selection)
    point = replace(relinearised(job, names, fit), patient=True)
    weights = weights_of(job, found.units)
    tests, not_tested = score_tests_of_job(point, weights, np.random.default_rng(_SEED), earlier)
    selection = refined_scans(point, continued(transferred(selection, tests)))
    return _Searched(point, tests, not_tested, found.units, selection)


def what_can_be_seen(job: AdjustedJob) -> Design:
    """Return what a measurement can detect; it does not depend on the residuals."""
    test_set, not_tested = score_tests_of_job(job, {}, np.random.default_rng(_SEED))
    return design(job, test_set, not_tested)


def _search_with_weights(job: AdjustedJob, rng: np.random.Generator, earlier: ScoreTests | None) -> _Searched:
    """Return the selection after the readings of each noisier unit were weighted by the noise found in it.

    `earlier` are tests of the same candidates, if there are any.
    """
    weights: Mapping[str, Array] = {}
    units: tuple[Unit, ...] = ()
    for _ in range(_ROUNDS + 1):
        tests, not_tested = score_tests_of_job(job, weights, rng, earlier)
        earlier = tests
        if tests.system.dof < 1:
            raise UndeterminedError(
                "the job has no redundant reading, so no reading can contradict its model\n"
                "measure more; `metrocli diagnose --design` shows what a measurement can detect"
            )
        last = len(units) == _ROUNDS
        unit = None if last else _sigma_first(job, tests)
        if unit is None:
            selection = search(tests, nothing_fitted(tests.system))
            # next to a dominant effect other structure is not searched for yet, and would count as noise
            searching_on = last or has_dominant_effect(selection)
            unit = None if searching_on else noisiest_unit(job, tests.system, selection.fitted())
            unit = None if unit is not None and _is_scatter(selection, unit) else unit
        if unit is None:
            break
        weights, units = reweighted(job, weights, unit), (*units, unit)
    return _Searched(job, tests, not_tested, _joined(units), selection)


def _is_scatter(selection: Selection, unit: Unit) -> bool:
    """Return whether an effect at all its places explains as much as the noise of a unit, which it then is."""
    found = scattered_throughout(selection)
    # the scatter was held against the noise of each group of readings already
    return found is not None and (unit.key == READING or found.log_level < unit.log_level)


def _sigma_first(job: AdjustedJob, test_set: ScoreTests) -> Unit | None:
    """Return the prior values whose stated sigma is wrong, if that explains the residuals better than any cause."""
    fitted = nothing_fitted(test_set.system)
    unit = noisiest_unit(job, test_set.system, fitted)
    if unit is None or unit.key != DECLARED_SIGMA or unit.ratio < 1:
        return None
    return unit if unit.log_level < log_level_of_strongest(test_set, fitted) else None


def _joined(units: Sequence[Unit]) -> tuple[Unit, ...]:
    """Return the units with one ratio each: the product of the ratios that were found one after the other."""
    found: dict[tuple[str, str], Unit] = {}
    for unit in units:
        before = found.get((unit.key, unit.name))
        found[unit.key, unit.name] = unit if before is None else replace(unit, ratio=unit.ratio * before.ratio)
    return tuple(found.values())


def _linear_change(job: AdjustedJob, system: System, name: NamedEffect) -> float:
    """Return the largest change of the delivered result by an effect, to first order."""
    alternative = name.alternative
    full = signature(job.model, system, alternative.effect, alternative.instance, dict(alternative.scanned))
    shift = system.shifts((full @ name.values)[:, None], job.delivered.blocks, job.delivered.columns)
    return float(np.sqrt((shift**2).sum(axis=(1, 2)).max(initial=0.0)))


def _separate(job: AdjustedJob, names: Sequence[NamedEffect]) -> tuple[str, ...]:
    """Return, in words, what to measure to distinguish the named effects from their best rivals."""
    found: dict[str, None] = {}
    for name in names:
        for rival in name.rivals[:2]:
            for words in separations(job, name.alternative, rival.alternative):
                found[words] = None
    return tuple(found)
