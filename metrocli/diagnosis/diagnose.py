"""The whole diagnosis of one adjusted job, from its linearised system to the verdict.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace

import numpy as np

from metrocli.adjust.clusters.robust import STRUCTURED
from metrocli.diagnosis.adjusted_job import AdjustedJob, Budget, Ordered
from metrocli.diagnosis.confirmation import with_confirmed, with_confirmed_effects
from metrocli.diagnosis.correlated_error import CorrelatedError
from metrocli.diagnosis.detectability import Detectability, design
from metrocli.diagnosis.evidence.folds import gain_between, gain_of_parts
from metrocli.diagnosis.evidence.gain import Gain
from metrocli.diagnosis.evidence.identified import IdentifiedEffect, identified
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.parts import SCATTER, Fixed, Random
from metrocli.diagnosis.evidence.prices import LEVEL
from metrocli.diagnosis.evidence.search import pruned
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.explanations import (
    correlated_errors,
    correlated_instead,
    noise_instead,
    random_effects,
    smooth,
    with_joint_rivals,
)
from metrocli.diagnosis.extended_fit import extended_fit, linear_change, readings_kept, result_changes, sizes
from metrocli.diagnosis.findings import UNREACHED, Diagnosis, Finding, RemainingStructure, Unconfirmed
from metrocli.diagnosis.laws.law import Law
from metrocli.diagnosis.laws.search import stood_for, with_laws
from metrocli.diagnosis.linear.memory import as_fits
from metrocli.diagnosis.noise import VarianceGroup, noise_of
from metrocli.diagnosis.power.collinear import separations
from metrocli.diagnosis.rounds import searched
from metrocli.diagnosis.wrong_readings import wrong_readings
from metrocli.effects.correlated import NAME as CORRELATED_ERROR
from metrocli.progress import SILENT, Progress
from metrocli.units import internal_unit

Attended = Callable[[Callable[[], None]], AbstractContextManager[object]]
"""Takes what interrupts a search, and calls it if the user wants that within the context"""
_CORRELATED = 0.005
"""Level below which a correlated error is reported as structure"""
_LEVEL = -float(np.log(LEVEL))
LIMIT = 120.0
"""CPU time for all searches [s]"""


def no_interrupt(heeded: Callable[[], None]) -> AbstractContextManager[object]:
    """Return a context in which nobody interrupts."""
    return nullcontext()


def diagnose(
    job: AdjustedJob,
    progress: Progress = SILENT,
    limit: float = LIMIT,
    attended: Attended = no_interrupt,
    ordered: Ordered = map,
    quick: bool = False,
) -> Diagnosis:
    """Return the diagnosis of an adjusted job; its searches take at most `limit` [s of CPU time].

    A search whose time is spent ends with what it has found; so does one that is interrupted within `attended`.
    `ordered` computes the folds of cross-validation, perhaps on other processors; the diagnosis is the same there.
    A `quick` one looks for effects, wrong readings and noisier groups, and states nothing on what it does not find.
    Raises UndeterminedError if the unknowns use up all readings, InputError if it needs more memory than there is.
    """
    job = as_fits(job)
    job = replace(job, model=job.model.about_no_scatter(), budget=Budget(limit))
    progress.doing("looking for structure", job.budget.left())
    with attended(job.budget.interrupt):
        first, state = searched(job, quick)
        state, lost = with_confirmed(job, state, quick)
        job = state.measurement.job
        laws: tuple[Law, ...] = ()
        if not quick:
            progress.doing("looking for a law in what no effect explains", job.budget.left())
            state, laws = with_laws(state, _in_white_noise(state), ordered)
    progress.doing("cross-validating: predicting parts of the readings from the others", job.budget.left())
    state, names, gained, unconfirmed = with_confirmed_effects(state, ordered, quick)
    names = names if quick else with_joint_rivals(state, names)
    kept = readings_kept(state.measurement, state.readings)
    # the job of the first round: in that of the last one, effects on its own blocks stand at a fixed size
    # neither in a quick diagnosis, whose changes of the result are to first order: each takes an adjustment
    fit = extended_fit(first.measurement.job, names, kept) if names and not quick else None
    shifts = [None] * len(names) if quick else result_changes(first.measurement.job, names, fit, kept)
    correlated, scattered = correlated_errors(state), random_effects(state)
    parts: list[Fixed | Random] = [*state.named, *(part for part in state.random if part.kind == SCATTER)]
    whole = gain_of_parts(state, parts) if scattered else None
    rivals = [(name.alternative, rival.alternative) for name in names for rival in name.rivals[:2] if not rival.beside]
    m, noise = state.measurement, noise_of(state)
    progress.doing("computing what the measurement could not detect")
    return Diagnosis(
        job=first.measurement.job,
        noise=noise,
        variance_groups=tuple(VarianceGroup(*m.units[number][:2], ratio) for number, ratio in m.noise.items()),
        outliers=wrong_readings(state),
        findings=tuple(_findings(state, zip(names, gained, shifts, strict=False), noise.ratio)),
        # the last gain is that of all names together
        left=_left(state, correlated, laws, whole or gained[-1] if names else whole, (*lost, *unconfirmed)),
        before=strongest(first),
        after=strongest(state),
        design=Detectability((), (), ()) if quick else design(state, noise.ratio, stood_for(laws)),
        separate_by=separations(state.measurement.job, rivals),
        adjusts=quick or fit is not None or not names,
        together=gained[-1] if len(names) > 1 else None,
        whole=whole,
        scatters=scattered,
        unconfirmed=(*lost, *unconfirmed),
        laws=laws,
        correlated_errors=correlated,
        limited=limit if job.budget.ended else None,
        interrupted=job.budget.interrupted,
        quick=quick,
    )


def _in_white_noise(state: State) -> State:
    """Return the identified effects and wrong readings of a state beside white noise, as the job declares it.

    A smooth effect is identified too.
    """
    shapes = smooth(state)
    if len(state.random) == len(shapes) and not state.measurement.noise:
        return state
    m = state.measurement.unweighted or state.measurement
    kept = [m.random(state.random[j].kind, state.random[j].key) for j in shapes]
    return pruned(state.at(m, random=False).plus(random=kept, logs=[float(state.logs[j]) for j in shapes]))


def strongest(state: State) -> float:
    """Return the level of the strongest candidate beside a state, counted over all."""
    # what held-out readings do not confirm is something all the same
    state = replace(state, measurement=state.measurement.refuting(()), cache={})
    # a net of 0 is just at the level, and one of -_LEVEL at the level 1: none counts as less
    gain, price, _ = state.gains_of_readings()
    of_families = map(state.nets, range(len(state.measurement.families)))
    nets = np.concatenate([[-_LEVEL], (gain - price)[gain > 0], *of_families])
    return float(np.exp(-max(float(nets.max()) + _LEVEL, 0.0)))


def _findings(
    state: State, named: Iterable[tuple[IdentifiedEffect, Gain, float | None]], noise: float
) -> Iterator[Finding]:
    """Yield the findings of identified effects, the one with the largest held-out log score first."""
    m = state.measurement
    for name, gain, shift in sorted(named, key=lambda entry: -entry[1].log_score):
        change = linear_change(m.job, m.system, name) if shift is None else shift
        part = next(entry for entry in state.named if entry.key == name.key)
        instead = (*noise_instead(state, part), *correlated_instead(state, part))
        yield Finding(name, sizes(m.job, name), gain, change, _other_shape_from(state, name, noise), instead)


def _other_shape_from(state: State, name: IdentifiedEffect, noise: float) -> float:
    """Return the smallest relative difference in shape that shows as structure beside an identified effect.

    It is `sqrt(lambda s^2 / |G theta|^2)`, lambda the gain in squares that the best single candidate needs.
    """
    from metrocli.diagnosis.linear.distributions import noncentrality, single_level

    m = state.measurement
    # without the last count, that of single readings: these are no other shape of an effect
    least = noncentrality(single_level(LEVEL, max(m.prices.tests[:-1], default=1.0)), 2, max(m.system.dof - 2, 1))
    return float(np.sqrt(least) * noise / max(name.shows, 1e-300))


def _left(
    state: State,
    correlated: Sequence[CorrelatedError],
    laws: Sequence[Law],
    gain: Gain | None,
    unconfirmed: Sequence[Unconfirmed],
) -> RemainingStructure | None:
    """Return what no identified effect explains: a law, an unknown cause, or a correlated error.

    A job whose noise is `structured` declares that what its images share varies smoothly with anything. `gain` is that
    of all that is identified.
    """
    job = state.measurement.job
    beyond = [error for error in correlated if error.log_level < np.log(_CORRELATED)]
    significant = beyond if job.noise_model != STRUCTURED else []
    # shares of a misfit in one unit: errors of angles do not add to those of lengths, nor are they little beside them
    alike = [error for error in correlated if significant and error.is_in_unit_of(job.reading[1])]
    smooth = sum((error.std * error.visible) ** 2 for error in alike)
    in_one_unit = all(error in alike for error in significant)
    law = next((law for law in laws if law.chosen), None)
    something = law is not None or bool(state.unknown) or bool(significant)
    misfit = _misfit(state, gain) if something and in_one_unit else None
    # the most specific first
    if law is not None:
        names = dict.fromkeys(name for term in law.terms for name in term.form.variables)
        where = tuple(name for _, name in law.terms[0].spot.where)
        return RemainingStructure(law.p_value, tuple(names), where, law.size, *_shares(law.size, misfit, smooth))
    for part in state.unknown:
        name = identified(state, part, with_rivals=False)
        size, unit = _size(state, part)
        return RemainingStructure(
            float(np.exp(name.log_level)),
            (state.measurement.families[part.family].unknown,),
            (),
            size,
            *_shares(size, misfit if unit == internal_unit(job.reading[1]) else None, smooth),
            job.noise_model == STRUCTURED,
            unit,
        )
    if significant:
        best = min(significant, key=lambda error: error.log_level)
        names = dict.fromkeys(error.covariate for error in significant)
        return RemainingStructure(
            float(np.exp(best.log_level)),
            tuple(names),
            (best.place,) if best.place else (),
            best.std * best.visible,
            smooth / misfit if misfit else None,
            unit=best.unit,
        )
    # what is not named is not explained: few images confirm nothing, however much they show
    against = [effect.name for effect in unconfirmed if effect.log_score <= 0]
    if (against or job.budget.ended) and (level := strongest(state)) < LEVEL:
        unnamed = f"what held-out readings do not confirm ({', '.join(against)})"
        return RemainingStructure(level, (unnamed if against else UNREACHED,))
    return None


def _misfit(state: State, gain: Gain | None) -> float | None:
    """Return the squares of errors that what is left is compared with, those before all that is identified.

    An extended job has its effects in the model: then it is compared with the errors that it has with them. Where it
    has correlated errors alone, what is left has to be little beside these, too.
    """
    least = np.inf
    if gain is None:
        m = state.measurement
        if not m.job.has_effects:
            stated = [added.std for added in m.job.model.added if added.effect.name == CORRELATED_ERROR]
            if not stated or len(m.system.rows_in_units) > 1:  # errors of several units have no common size
                return None
            least = max(stated) ** 2
        gain = gain_between(state, state)
    return min(gain.before**2, least) if gain.before else None


def _shares(size: float, misfit: float | None, smooth: float) -> tuple[float | None, float]:
    """Return the share in a misfit of what both its sides have, and that of the squares of smooth errors beside it."""
    return (size**2 / (misfit + size**2), smooth / (misfit + size**2)) if size and misfit else (None, 0.0)


def _size(state: State, part: Fixed) -> tuple[float, str]:
    """Return the root mean square of what a fixed part explains in readings of the unit that shows most, and that."""
    system = state.measurement.system
    change = state.beside(part).residual - state.residual
    unit, rows = system.showing(change)
    shown = (change * system.scale)[rows & (change != 0)]
    return float(np.sqrt((shown**2).mean())) if len(shown) else 0.0, unit


def what_can_be_seen(job: AdjustedJob) -> Detectability:
    """Return what a measurement can detect; it does not depend on the residuals.

    Raises InputError if this needs more memory than there is.
    """
    m = measurement_of(as_fits(job))
    # residuals of 0: they would enter the noise, and the upper bounds of the candidates
    return design(State.of(replace(m, system=replace(m.system, residual=np.zeros(m.system.rows)))))
