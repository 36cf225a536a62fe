"""Rounds: the job is adjusted with the effects that dominate, and the search goes on about that solution.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from math import log

from metrocli.adjust.clusters.robust import STRUCTURED
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.evidence.folds import surely
from metrocli.diagnosis.evidence.identified import IdentifiedEffect, all_identified
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.moves import effects
from metrocli.diagnosis.evidence.parts import LARGEST, SCATTER, Fixed, Random
from metrocli.diagnosis.evidence.prices import ALIKE
from metrocli.diagnosis.evidence.refined import refined
from metrocli.diagnosis.evidence.search import against_smooth, forward, pruned, swapped
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.evidence.weights import with_noise
from metrocli.diagnosis.extended_fit import extended_fit_and_cost, readings_kept, relinearised, with_group_noise
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass

_ROUNDS = 4
_DOMINANT = 4.0
"""Effects are dominant if they lower the mean square by this factor"""
_RIVAL, _RIVALS = 0.1, 3
"""Share of the net gain of a term of a lens from which others are tried in its place, and how many"""
_MOST_OF_IT = 0.01
"""Share of all that was gained by which a move must raise the score in a quick search"""


def is_dominated(state: State) -> bool:
    """Return whether the unknowns are to be adjusted with effects of a state, and the search to go on about them.

    Signatures are derivatives, and the higher-order terms of a large effect look like other effects. An effect that is
    columns of the job's own blocks, such as a term of a lens, bends beside the others: only about its own solution
    differs it from those that look alike (docs/decisions/264-terms-of-a-lens-bend.md).
    """
    old, new = _old_and_new(state)
    own = any(state.measurement.alternative(part.key).effect.link is None for part in new)
    return own or (bool(new) and _mean_square(state, old) > _DOMINANT * _mean_square(state, state.named))


@dataclass(frozen=True)
class Gross:
    """What does not take part where the job is adjusted to linearise it.

    A gross reading moves the unknowns so far that about their solution derivatives do not hold, and what they miss
    looks like effects. An adjustment without it does not know it.
    """

    readings: Mapping[tuple[int, ...], Fixed]
    """Wrong readings by key"""
    noise: Mapping[int, float]
    """Ratios of the noise of variance groups, such as an image whose targets have wrong names"""

    def beside(self, state: State) -> Gross | None:
        """Return it with what is gross in a state; None where nothing is that was not known."""
        new: dict[tuple[int, ...], Fixed] = {part.key: part for part in state.readings if part.key not in self.readings}
        old = [*_old_and_new(state)[0], *self.readings.values()]
        if new and _mean_square(state, old) <= _DOMINANT * _mean_square(state, [*old, *new.values()]):
            new = {}
        noisy = {number: ratio for number, ratio in state.measurement.noise.items() if 2 * log(ratio) > LARGEST}
        if not new and noisy.keys() <= self.noise.keys():
            return None
        return Gross({**self.readings, **new}, {**self.noise, **noisy})


def _mean_square(state: State, fixed: Sequence[Fixed]) -> float:
    return State.of(state.measurement, fixed).variance


def is_overwhelmed(state: State) -> bool:
    """Return whether most of the misfit comes from one effect with which the unknowns are not adjusted yet.

    The search does not go on then. It does where many explain the misfit together: without the correlated errors that
    take their place later, most of them would be wrong, and the unknowns adjusted with them as well.
    """
    old, new = _old_and_new(state)
    before = _mean_square(state, old) if new else 0.0
    return any(before > _DOMINANT * _mean_square(state, [*old, part]) for part in new)


def _is_smoothed(state: State) -> bool:
    """Return whether smooth errors explain most of the misfit, as they do where a large term of a lens is missing.

    The job's own terms have bent to take the place of one whose signature about that solution is another.
    """
    m = state.measurement
    has_terms = any(family.effect.link is None for family in m.families if family.alternatives)
    smooth = [part for part in state.random if part.kind != SCATTER or m.scatters[part.key[0]][0].effect.is_smooth]
    return has_terms and bool(smooth) and state.minus(smooth).variance > _DOMINANT * state.variance


def _old_and_new(state: State) -> tuple[list[Fixed], list[Fixed]]:
    """Return the effects with which the unknowns are adjusted, and the others."""
    m = state.measurement
    adjusted = [m.alternative(part.key).spot in m.job.adjusted for part in state.named]
    both = [*zip(state.named, adjusted, strict=True)]
    return [part for part, is_old in both if is_old], [part for part, is_old in both if not is_old]


def _standing(state: State, m: Measurement) -> State:
    """Return a state in another linearisation, with what it has found in the first one.

    It begins anew where the candidates are not the same, as after a scan whose best value was refined: with the terms
    of the job's own blocks with which that solution is adjusted.
    """
    noise, alike = state.measurement.noise, _candidates(state.measurement) == _candidates(m)
    if not alike:
        terms = {(standing.effect.name, standing.instance) for standing in m.job.standing}
        every = ((family, at) for family, one in enumerate(m.families) for at in range(len(one.alternatives)))
        return State.of(m, [m.effect(*key) for key in every if m.alternative(key).spot in terms])
    return state.at(with_noise(m, noise) if noise else m).settled()


def _with_rivals(state: State, others: Sequence[State]) -> State:
    """Return a state whose terms of a lens have as rivals those that explain as well, each about its own solution.

    To first order about the solution with one term, another that bends differently explains less.
    """
    # keys are those of other effects where the candidates are others
    for other in (each for each in others if _candidates(each.measurement) == _candidates(state.measurement)):
        ahead, mine = other.score - state.score, {part.key for part in state.named}
        new = [part for part in other.named if part.key not in mine]
        gone = [part for part in state.named if part.key not in {one.key for one in other.named}]
        if ahead > -ALIKE and len(gone) == len(new) == 1:
            rivals = (*gone[0].rivals, (new[0].key, min(ahead, 0.0)))
            state = state.with_fixed(state.fixed.index(gone[0]), replace(gone[0], rivals=rivals))
    return state


def _candidates(m: Measurement) -> list[object]:
    """Return what the numbers of parts, and of variance groups, stand for."""
    scatters = [[family.form for family in scatter] for scatter in m.scatters]
    return [
        [family.form for family in m.families],
        scatters,
        [knots.name for knots in m.knots],
        [unit[:2] for unit in m.units],
    ]


def _chosen_anew(state: State) -> State:
    """Return a state in which each effect on the job's own blocks is the best that stands in its place there.

    Only about its own solution differs it from those that look alike.
    """
    for part in state.named:
        if state.measurement.alternative(part.key).effect.link is None:
            less = state.minus([part])
            others = (move.made(less) for move in effects(less) if move.keys != (part.key,))
            state = max((state, *others), key=lambda candidate: candidate.score)
    return state


@dataclass(frozen=True)
class _Fit:
    """A job adjusted with the effects of a state."""

    state: State
    names: Sequence[IdentifiedEffect]
    job: AdjustedJob | None
    """None if it cannot be adjusted"""
    score: float
    """Of the adjustment, less the prices of the effects"""

    @classmethod
    def of(cls, job: AdjustedJob, state: State, gross: Gross | None, known: Gross) -> _Fit:
        """Adjust a job; what was found to be `gross` in this round leaves only effects that it is adjusted with."""
        m = state.measurement
        # effects that are found beside a gross reading, and not adjusted yet, are perhaps its higher-order terms
        named = all_identified(state, with_rivals=False)
        names = [name for name in named if gross is None or name.alternative.spot in m.job.adjusted]
        noisier = with_group_noise(job, m, known.noise)
        fit, cost = extended_fit_and_cost(noisier, names, readings_kept(m, known.readings.values()))
        price = sum(part.price for part in state.named)
        return cls(state, names, fit, -cost / (2 * max(state.variance, 1e-300)) - price)

    def relinearised(self, job: AdjustedJob) -> AdjustedJob:
        """Return the job with its unknowns at the values of the adjustment."""
        return job if self.job is None else relinearised(job, self.names, self.job)


def _fits(job: AdjustedJob, state: State, gross: Gross | None, known: Gross) -> list[_Fit]:
    """Return a job adjusted with the effects of a state, and with another term of a lens in a place of one that is new.

    That is the term with which the adjustment leaves least, if it leaves less than the first. The terms of the job bend
    to take the place of one that is missing: to first order about their solution another may explain more than it.
    """
    best = first = _Fit.of(job, state, gross, known)
    new = _old_and_new(state)[1] if gross is None else ()
    replaced = [part for part in new if state.measurement.alternative(part.key).effect.link is None]
    smoothed = [(state, None)] if gross is None and _is_smoothed(state) else []
    trials = [*((state.minus([part]), part.key) for part in replaced), *smoothed]
    for less, key in trials:
        others = (_Fit.of(job, less.plus([rival]), gross, known) for rival in _terms_instead(less, key))
        best = max([best, *others], key=lambda fit: fit.score)
    return [first] if best is first else [first, best]


def _terms_instead(less: State, key: tuple[int, ...] | None) -> list[Fixed]:
    """Return the terms of a lens that explain much of what one of them does, or the best one, the best first."""
    # without random effects: a smooth shift over the image would take what the terms differ in
    m, scored = less.measurement, list[tuple[float, int, int]]()
    alone = State.of(m, less.named)
    for family in (number for number, group in enumerate(m.families) if not group.unknown):
        gain, price, _ = alone.gains_of_family(family)
        scored += [(float(net), family, at) for at, net in enumerate(gain - price)]
    scored = [one for one in scored if m.alternative(one[1:]).effect.link is None]
    own = max((net for net, *at in scored if key in (None, tuple(at))), default=0.0)
    terms = (tuple(at) for net, *at in sorted(scored, reverse=True) if net > _RIVAL * own > 0)
    taken = {part.key for part in less.named} | {key}
    return [m.effect(*at) for at in islice((at for at in terms if at not in taken), _RIVALS)]


def searched(job: AdjustedJob, quick: bool = False) -> tuple[State, State]:
    """Return the state of a job as it is, and that of the search about the solution with its dominant effects.

    A quick search looks for no smooth effects, and for correlated errors only beside what it has found.
    Raises UndeterminedError if no reading is redundant.
    """
    m = measurement_of(job, quick=_is_alone(job, quick))
    if m.system.dof < 1:
        raise UndeterminedError(
            "the job has no redundant reading, so no reading can contradict its model\n"
            "measure more; `metrocli diagnose --design` shows what a measurement can detect"
        )
    first = State.of(m)
    return first, searched_from(job, first, quick)


def searched_from(job: AdjustedJob, begin: State, quick: bool, without: Sequence[Random] = ()) -> State:
    """Return the state of the search that goes on from one, about the solution with its dominant effects."""
    m, state, alone = begin.measurement, begin, _is_alone(job, quick)
    since, least = begin.score, _MOST_OF_IT if quick else 0.0
    # None once the job cannot be adjusted without what is gross
    known: Gross | None = Gross({}, {})

    def ends_it(other: State) -> bool:
        return is_overwhelmed(other) or (known is not None and known.beside(other) is not None)

    for left in reversed(range(_ROUNDS)):
        # in the last round nothing stops the search: what dominates then is named about the solution that there is
        state = forward(begin, stop=ends_it if left else None, least=least, since=since, without=without)
        # not adjusted with effects whose sizes may be nothing: all else would be linearised about these sizes
        state = state if quick else surely(state)
        gross = None if known is None else known.beside(state)
        dominated = gross is not None or is_dominated(state)
        if not left or not (dominated or _is_smoothed(state)):
            break
        known = gross or known
        fits = [fit for fit in _fits(job, state, gross, known or Gross({}, {})) if fit.job is not None]
        if not dominated:
            # what is smooth stays as it was found, unless about the solution with a term the state is better
            fits = [fit for fit in fits if fit.state is not state]
            if not fits:
                break
        if not fits and known is not None and (known.readings or known.noise):
            # too few readings are left of something: from now on all of them take part
            known, begin = None, state
            continue
        if not fits:
            # the job cannot be adjusted with them: then the search goes on beside their first order
            state = forward(state, least=least, since=since, without=without)
            break
        standing = [_standing(fit.state, measurement_of(fit.relinearised(job), None, m, alone)) for fit in fits]
        begun = [pruned(_chosen_anew(each)) for each in standing]
        # the adjustments do not know correlated errors and random effects, the states do
        best, continued = max(zip((fit.state for fit in fits), begun, strict=True), key=lambda both: both[1].score)
        continued = _with_rivals(continued, standing)
        if not dominated and continued.score <= state.score:
            break
        state = best
        m = continued.measurement
        # what the search found before an effect overwhelmed all else was perhaps its higher-order terms
        begin = State.of(m)
        since = begin.score
        begin = begin if gross or is_overwhelmed(state) else continued
    return pruned(refined(against_smooth(state) if quick else swapped(state, without)))


def _is_alone(job: AdjustedJob, quick: bool) -> bool:
    """Return whether a search looks for effects alone: a job that declares correlated errors has them."""
    return quick and job.noise_model != STRUCTURED
