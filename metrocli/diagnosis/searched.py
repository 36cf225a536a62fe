"""The search of a diagnosis: about the solution with large effects, with weights, and with what scatters throughout.

Method: docs/algorithms/selection-and-levels.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.cross_validation import Gain, gain_of_model
from metrocli.diagnosis.extended_fit import (
    adjusted_with_all,
    is_linear,
    readings_kept,
    relinearised,
    result_change,
    score_tests_of_job,
    weights_of,
    with_scatter,
)
from metrocli.diagnosis.fit_of_names import FitOfNames
from metrocli.diagnosis.linear.candidates import Alternative, NotTested
from metrocli.diagnosis.linear.fitted_columns import FittedColumns, nothing_fitted
from metrocli.diagnosis.linear.projection import READING
from metrocli.diagnosis.linear.random_columns import beside_random_columns
from metrocli.diagnosis.linear.score_tests import ScoreTests
from metrocli.diagnosis.noise import DECLARED_SIGMA, Unit, noise_instead, noisier_units, reweighted
from metrocli.diagnosis.residual_structure import log_level_of_strongest
from metrocli.diagnosis.selection.all_of_a_kind import (
    AllOfAKind,
    all_of_a_kind,
    estimated_again,
    scattered_throughout,
)
from metrocli.diagnosis.selection.confidence_set import confidence_sets
from metrocli.diagnosis.selection.refined_scan import refined_scans
from metrocli.diagnosis.selection.search import STRUCTURED, continued, search, transferred
from metrocli.diagnosis.selection.selection_state import Selection
from metrocli.diagnosis.selection.thresholds import has_dominant_effect
from metrocli.diagnosis.smooth_errors.process import Process
from metrocli.diagnosis.smooth_errors.race import process_in, stands_for
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass
from metrocli.progress import Progress

_ROUNDS = 3
"""Largest number of noisier units that are reweighted, one after the other"""
_SEARCHES = 5
"""Largest number of searches; each follows an adjustment with the effects that dominated the previous one"""
_PROCESSES = 3
"""Largest number of smooth processes that are taken for noise, one after the other"""
_KINDS = 2
"""Largest number of effects that act at all places of a kind"""
_ESTIMATES, _STAYS = 3, float(np.log(1.2))
"""Largest number of searches with such an effect in the model, and the change of ln std that calls for another"""
SEED = 20
"""Of the draws that count the levels"""


@dataclass(frozen=True)
class Scatter:
    """An effect that acts at all its places, with sizes that scatter about 0."""

    found: AllOfAKind
    gain: Gain
    shift: float
    """Largest change of the delivered result when it is taken into the model"""


@dataclass(frozen=True)
class Searched:
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
    of_names: FitOfNames | None = None
    """The job adjusted with the effects that were named beside white noise"""

    @property
    def beside_white_noise(self) -> Selection:
        """The selection beside white noise."""
        return self.selection if self.plain is None else self.plain

    def with_white_noise(self, selection: Selection) -> Searched:
        """Return the search with a selection beside white noise, and without processes."""
        tests = self.tests if self.plain is None else selection.test_set
        return replace(self, tests=tests, selection=selection, processes=(), plain=None)


def search_about_solution(job: AdjustedJob, progress: Progress) -> Searched:
    """Return the selection beside the noise that the readings show, linearised about the job with its large effects."""
    return _with_processes(_search_beside_white_noise(job, progress), progress)


def _with_processes(searched: Searched, progress: Progress) -> Searched:
    """Return the search repeated beside the smooth processes that the readings show, one after the other."""
    job, tests, selection = searched.job, searched.tests, searched.selection
    plain, processes = selection, list[Process]()
    # places that are off throughout are a cause; a process of each of them would take it for chance
    scatter = scattered_throughout(selection)
    caused = all_of_a_kind(selection) or (scatter is not None and not stands_for(job, selection, scatter))
    while not caused and len(processes) < _PROCESSES and not job.budget.spent():
        found = process_in(job, selection)
        if found is None:
            break
        progress.doing(f"searching beside an error that varies smoothly with {found.covariate}", job.budget.left())
        rng, before = np.random.default_rng(SEED), selection
        tests = beside_random_columns(tests, found.columns, rng, job.single_components)
        selection = refined_scans(job, search(tests, nothing_fitted(tests.system), STRUCTURED))
        processes.append(replace(found, instead_of=_not_in(selection, map(before.alternative, before.named))))
    if len(selection.unknown) >= STRUCTURED:
        # no further process explains the structure, so it is taken up by as many smooth terms as there are
        selection = refined_scans(job, continued(selection))
    if not processes:
        return replace(searched, selection=selection)
    final = {selection.alternative(one).spot for one in selection.named}
    processes = [
        replace(one, instead_of=tuple(lost for lost in one.instead_of if lost.spot not in final)) for one in processes
    ]
    kept = transferred(selection, plain.test_set)
    for one in plain.unknown:
        kept = kept.with_one(one)
    return replace(searched, tests=tests, selection=selection, processes=tuple(processes), plain=kept)


def _not_in(selection: Selection, effects: Iterable[Alternative]) -> tuple[Alternative, ...]:
    """Return the effects that a selection does not name; none if it names others in their place."""
    named, wanted = {selection.alternative(one).spot for one in selection.named}, list(effects)
    return tuple(one for one in wanted if one.spot not in named) if len(named) < len(wanted) else ()


def _search_beside_white_noise(job: AdjustedJob, progress: Progress) -> Searched:
    """Return the selection beside white noise, linearised about the job with its dominant effects adjusted.

    Why: decision 051.

    If effects dominate, the job is adjusted with them, and the search is repeated about that solution with them among
    all other candidates. At the end the search continues about the job adjusted with all effects that were named; where
    the model is linear up to there, nothing is linearised again.
    """
    point = job
    earlier: ScoreTests | None = None
    for left in reversed(range(_SEARCHES)):
        point = point if left else replace(point, patient=True)
        found = _search_with_weights(point, np.random.default_rng(SEED), earlier)
        earlier = found.tests
        selection = refined_scans(point, found.selection)
        if not has_dominant_effect(selection):
            break
        progress.doing("adjusting with what was found", job.budget.left())
        names = confidence_sets(selection)
        fit = FitOfNames.of(job, names, readings_kept(selection)).fit
        point = replace(point, patient=True) if fit is None else relinearised(job, names, fit)
    names = confidence_sets(selection)
    of_names = FitOfNames.of(job, names, readings_kept(selection))
    found, fit = replace(found, of_names=of_names), of_names.fit
    if fit is None:
        return replace(found, job=point, selection=selection)
    if is_linear(selection, fit):
        patient = adjusted_with_all(selection.test_set)
        selection = refined_scans(point, continued(replace(selection, test_set=patient), STRUCTURED))
        return replace(found, tests=adjusted_with_all(found.tests), selection=selection)
    point = replace(relinearised(job, names, fit), patient=True)
    weights = weights_of(job, found.units)
    tests, not_tested = score_tests_of_job(point, weights, np.random.default_rng(SEED), earlier)
    selection = refined_scans(point, continued(transferred(selection, tests), STRUCTURED))
    return replace(found, job=point, tests=tests, not_tested=not_tested, selection=selection)


def with_scatters(
    job: AdjustedJob, searched: Searched, progress: Progress
) -> tuple[AdjustedJob, Searched, tuple[Scatter, ...]]:
    """Return the job and the search with effects at all places of a kind in the model, where these explain more."""
    scatters: list[Scatter] = []
    while len(scatters) < _KINDS:
        found = all_of_a_kind(searched.selection) or scattered_throughout(searched.selection)
        # the standard deviation of one that is in the model already is tested as any that is declared
        if found is None or found.effect.name in {one.effect.name for one in job.model.added if one.std}:
            break
        progress.doing(f"adjusting with {found.effect.name} at every {found.effect.keys[0]}", job.budget.left())
        settled = _with_scatter(job, searched, found, progress)
        if settled is None:
            break
        found, wider, after = settled
        gain = gain_of_model(job, _others(searched, found.effect.name), _others(after))
        scatters.append(Scatter(found, gain, result_change(job, wider)))
        job, searched = wider, after
    return job, searched, tuple(scatters)


def _with_scatter(
    job: AdjustedJob, searched: Searched, found: AllOfAKind, progress: Progress
) -> tuple[AllOfAKind, AdjustedJob, Searched] | None:
    """Return a scatter, the job with it in the model, and the search about that; None if it cannot be adjusted.

    Its standard deviation is estimated again beside what the search then finds, until it stays.
    """
    kept, done = readings_kept(searched.selection), None
    for _ in range(_ESTIMATES):
        wider = with_scatter(job, found, kept)
        if wider is None:
            break
        after = search_about_solution(wider, progress)
        done = found, wider, after
        again = estimated_again(found, transferred(after.selection, searched.tests))
        if abs(np.log(again.std / found.std)) < _STAYS:
            break
        found, kept = again, readings_kept(after.selection)
    return done


def _others(searched: Searched, name: str = "") -> tuple[ScoreTests, FittedColumns]:
    """Return the fit of what was selected, without smooth terms and without the effects of a name."""
    selection = searched.selection
    own = [one for one in selection.named if selection.test_set.families[one.family].name == name]
    return selection.test_set, selection.fitted(without=[*own, *selection.unknown])


def _search_with_weights(job: AdjustedJob, rng: np.random.Generator, earlier: ScoreTests | None) -> Searched:
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
        most = _ROUNDS - len(units)
        noisier = _sigma_first(job, tests) if most else ()
        if not noisier:
            selection = search(tests, nothing_fitted(tests.system), STRUCTURED)
            # next to a dominant effect other structure is not searched for yet, and would count as noise
            if most and not has_dominant_effect(selection):
                noisier = _noisier_beside(job, selection, most)
        if not noisier:
            break
        for unit in noisier:
            weights = reweighted(job, weights, unit)
        units = (*units, *noisier)
    return Searched(job, tests, not_tested, _joined(units), selection)


def _noisier_beside(job: AdjustedJob, selection: Selection, most: int) -> tuple[Unit, ...]:
    """Return the noisier units beside a selection, at most so many.

    An effect at all its places that explains as much as the noise of a unit is what makes this noisier.
    """
    noisier = _of_no_effect(job, noisier_units(job, selection.test_set.system, selection.fitted(), most))
    if not noisier:
        unit = noise_instead(job, selection)
        return () if unit is None else (unit,)
    scatter = scattered_throughout(selection)
    # the scatter was held against the noise of each group of readings already
    explained = scatter is not None and (noisier[0].key == READING or scatter.log_level < noisier[0].log_level)
    return () if explained else noisier


def _sigma_first(job: AdjustedJob, test_set: ScoreTests) -> tuple[Unit, ...]:
    """Return the prior values whose stated sigma is wrong, if that explains the residuals better than any cause."""
    fitted = nothing_fitted(test_set.system)
    units = _of_no_effect(job, noisier_units(job, test_set.system, fitted))
    stated = all(unit.key == DECLARED_SIGMA and unit.ratio >= 1 for unit in units)
    return units if stated and all(one.log_level < log_level_of_strongest(test_set, fitted) for one in units) else ()


def _of_no_effect(job: AdjustedJob, units: Sequence[Unit]) -> tuple[Unit, ...]:
    """Return the units without prior values that scatter more than stated where an effect is this scatter."""
    places = (job.model.places.get(one.keys[0]) for one in job.effects if one.throughout)
    left = {place.index for place in places if place is not None}
    own = {group.name for group in job.model.others if left.issuperset(group.chain.blocks)}
    return tuple(one for one in units if one.key != DECLARED_SIGMA or one.ratio <= 1 or one.name not in own)


def _joined(units: Sequence[Unit]) -> tuple[Unit, ...]:
    """Return the units with one ratio each: the product of the ratios that were found one after the other."""
    found: dict[tuple[str, str], Unit] = {}
    for unit in units:
        before = found.get((unit.key, unit.name))
        found[unit.key, unit.name] = unit if before is None else replace(unit, ratio=unit.ratio * before.ratio)
    return tuple(found.values())
