"""Random parts of a state as a diagnosis states them: effects at all their places, and correlated errors.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.observations import Mask
from metrocli.diagnosis.correlated_error import CorrelatedError
from metrocli.diagnosis.evidence import variances
from metrocli.diagnosis.evidence.folds import gain_of_parts
from metrocli.diagnosis.evidence.identified import IdentifiedEffect, Rival
from metrocli.diagnosis.evidence.measurement import LENGTHS
from metrocli.diagnosis.evidence.moves import Move, effects
from metrocli.diagnosis.evidence.parts import CORRELATED, EFFECT, SCATTER, Fixed, Random
from metrocli.diagnosis.evidence.prices import ALIKE
from metrocli.diagnosis.evidence.refined import refined
from metrocli.diagnosis.evidence.search import forward
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.evidence.weights import tried_noise
from metrocli.diagnosis.extended_fit import readings_kept, result_change, with_random_effect
from metrocli.diagnosis.findings import DEPENDS_ON, OF_EACH, Instead, RandomEffect
from metrocli.diagnosis.linear.distributions import log_family
from metrocli.diagnosis.linear.projection import READING
from metrocli.diagnosis.noise import AS_OTHERS, DECLARED_SIGMA
from metrocli.effects.correlated import NAME as CORRELATED_ERROR
from metrocli.effects.effect import Effect

_PART, _TOGETHER = 0.25, 3
"""Share of the net evidence of an effect that another has where several may explain it together, and how many may"""
_MOST_ROWS = 8
"""Largest number of rows of a unit, for each parameter of an effect at it, whose noise can imitate the effect"""


def log_level_of(gain: float) -> float:
    """Return ln of the level of a gain by one variance: half a chi-squared with one degree of freedom."""
    from scipy.special import log_ndtr

    return float(log_ndtr(-np.sqrt(max(2 * gain, 0.0))))


def random_effects(state: State) -> tuple[RandomEffect, ...]:
    """Return the effects at all their places."""
    return tuple(_random_effect(state, j) for j, part in enumerate(state.random) if part.kind == SCATTER)


def _random_effect(state: State, number: int) -> RandomEffect:
    m, part = state.measurement, state.random[number]
    families = m.scatters[part.key[0]]
    effect, less = families[0].effect, state.minus([part])
    # `logs` are ratios to the variance of the noise, whose estimate is squares / dof
    std = float(np.sqrt(np.exp(state.logs[number]) * state.fit.squares / state.fit.dof)) * part.unit
    wider = with_random_effect(m.job, effect, std, readings_kept(m, state.readings))
    return RandomEffect(
        effect,
        std,
        std * relative_spread(state, number),
        float(log_family(log_level_of(state.score + part.price - less.score), m.prices.causes)),
        sum(int(family.shown.any(axis=1).sum()) for family in families),
        _as_likely(state, less),
        gain_of_parts(state, [part]),
        0.0 if wider is None else result_change(m.job, wider),
    )


def _as_likely(state: State, less: State) -> tuple[Instead, ...]:
    """Return the noise of a group of readings that explains as much as a random effect, of which `less` is without."""
    candidates = list[Instead]()
    for number, (key, _, _) in enumerate(state.measurement.units):
        if key == READING and number not in state.measurement.noise:
            candidates += _as_noise(state, less, number, less.ratio_of(number))
    return tuple(candidates)


def noise_instead(state: State, part: Fixed) -> tuple[Instead, ...]:
    """Return the larger noise of the unit at which an effect acts, if it explains the readings as well.

    That of a unit of few readings, such as an image of three targets, can look like a bad pose of it. So can that of
    given values, of which one is wrong.
    """
    m = state.measurement
    where, noises = m.alternative(part.key).where, list[Instead]()
    for number, (key, name, rows) in enumerate(m.units):
        here = where.get(key) == name or (key == DECLARED_SIGMA and any(name.endswith(f" {kind}") for kind in where))
        if here and rows.sum() <= _MOST_ROWS * part.rank and number not in m.noise:
            less = state.minus([part])
            # at least the ratio from which a noise is reported: a smaller one is that of all readings, and no answer
            noises += _as_noise(state, less, number, max(less.ratio_of(number), AS_OTHERS))
    return tuple(noises)


def _as_noise(state: State, less: State, number: int, ratio: float) -> list[Instead]:
    """Return the noise of a variance group if it explains as much, at a ratio, as the part that `less` is without."""
    ahead = tried_noise(less, {number: ratio}).score - state.score
    if ahead <= -ALIKE:
        return []
    key, name, _ = state.measurement.units[number]
    # exp overflows above 709
    return [Instead("noise", {key: name}, float(np.exp(min(ahead, 700.0))))]


def correlated_instead(state: State, part: Fixed) -> tuple[Instead, ...]:
    """Return the correlated error that explains the readings better than an effect, which is preferred to it.

    Where it explains them less well, it is no rival: it is a worse explanation, and names no cause.
    """
    m, less = state.measurement, state.minus([part])
    # with all sizes estimated anew it explains less than at first
    entering = next((each for each in variances.correlated_errors(less, set(), 1)), None)
    if entering is None or entering.net <= state.score - less.score:
        return ()
    ahead = refined(Move(entering.net, entering=entering).made(less)).score - state.score
    if ahead <= 0:
        return ()
    functions, unit = m.knots[entering.key[0]], entering.key[2]
    where = {DEPENDS_ON: functions.name}
    if unit >= 0:
        where[functions.by] = m.job.model.places[functions.by].names[unit]
    elif functions.by:
        where[OF_EACH] = functions.by
    return (Instead(CORRELATED_ERROR, where, float(np.exp(min(ahead, 700.0)))),)


def relative_spread(state: State, number: int) -> float:
    """Return the relative uncertainty of the standard deviation of a random part, from the likelihood's bend."""
    bend = float(state.fit.slopes[2][number])
    # ln of a variance has the variance 2 / bend, and a standard deviation half the relative uncertainty of its square
    return float(1 / np.sqrt(max(2 * bend, 1e-12)))


def correlated_errors(state: State) -> tuple[CorrelatedError, ...]:
    """Return the correlated errors of a state, those of the largest gain first."""
    errors = (_correlated(state, j) for j, part in enumerate(state.random) if part.kind == CORRELATED)
    return tuple(sorted(errors, key=lambda error: -error.gain))


def _correlated(state: State, number: int) -> CorrelatedError:
    m, component = state.measurement, state.random[number]
    less = state.minus([component])
    gain = state.score + component.price - less.score
    without = (move for move in effects(less) if move.net > 0)
    functions = m.knots[component.key[0]]
    own = component.columns.any(axis=1)
    unit, of_unit = m.system.showing(np.where(own, less.residual - state.residual, 0.0))
    rows = of_unit & own
    visible = _visible(state, component)
    std = float(np.sqrt(np.exp(state.logs[number]) * state.fit.squares / state.fit.dof)) * functions.sigmas[unit]
    if len(functions.sigmas) > 1:
        # one variance is for all, in units of their noise; what readings of one unit show is theirs
        visible = visible if component.local else _visible_at(state, component, rows)
        shown = ((less.residual - state.residual) * m.system.scale)[rows]
        std = float(np.sqrt((shown**2).mean())) / max(visible, 1e-300)
    count = m.tried * (functions.count if component.key[2] >= 0 else 1)
    level = min(log_level_of(gain) + float(np.log(count)), 0.0)
    place = m.job.model.places[functions.by].names[component.key[2]] if component.key[2] >= 0 else ""
    return CorrelatedError(
        functions.name,
        functions.by,
        LENGTHS[component.key[1]],
        std,
        std * relative_spread(state, number),
        visible,
        unit,
        level,
        gain,
        place,
        tuple(m.alternative(part.key) for move in without for part in move.fixed if part.sort == EFFECT),
    )


def _visible_at(state: State, part: Random, rows: Mask) -> float:
    """Return the share of a correlated error that the unknowns leave in some of the readings that have it."""
    seen, whole = (
        float((columns[rows] ** 2).sum()) for columns in (state.measurement.system.seen(part.columns), part.columns)
    )
    return float(np.sqrt(seen / max(whole, 1e-300)))


def _visible(state: State, part: Random) -> float:
    """Return the share of a correlated error that the unknowns leave in the readings (root mean square)."""
    m = state.measurement
    basis = m.system.basis.of_members
    whole = float((part.columns**2).sum())
    if part.local:
        inside = 0.0
        for rows in m.rows_of_members:
            both = np.concatenate([basis.local[rows], m.system.basis.shared[rows]], axis=1)
            inside += float(((both.T @ part.columns[rows]) ** 2).sum())
    else:
        inside = float((m.system.basis.coordinates(part.columns) ** 2).sum())
    return float(np.sqrt(max(1 - inside / max(whole, 1e-300), 0.0)))


def effect_of(state: State, part: Random) -> Effect:
    """Return the effect that acts at all its places by a random part of a state."""
    return state.measurement.scatters[part.key[0]][0].effect


def with_joint_rivals(state: State, names: Sequence[IdentifiedEffect]) -> tuple[IdentifiedEffect, ...]:
    """Return effects with those that explain the readings as well in the place of one of them, but only together.

    A tilted sensor is nearly a skew with a thin prism. Each effect that another one can stand for in part is left out
    in turn, and the search goes on without it.
    """
    return tuple(replace(name, rivals=(*name.rivals, *_joint_rivals(state, name))) for name in names)


def _joint_rivals(state: State, name: IdentifiedEffect) -> Iterator[Rival]:
    if name.second < _PART:
        return
    part = next(entry for entry in state.named if entry.key == name.key)
    less = state.minus([part])
    other = forward(less, _TOGETHER, without=[part])
    m, odds = other.measurement, other.score - state.score
    # by cause and place: values of a scan are refined as the search goes on
    kept, every = ({one.measurement.alternative(each.key).spot for each in one.named} for one in (less, other))
    new = [one for one in (m.alternative(entry.key) for entry in other.named) if one.spot not in kept]
    # what enters as noise, a correlated error or a wrong reading, or leaves, is no effect in its place
    alike = len(other.random) <= len(less.random) and len(m.noise) <= len(state.measurement.noise)
    alike &= len(other.readings) <= len(less.readings) and kept <= every and len(new) > 1
    if odds < -ALIKE or not alike or name.alternative.spot in every:
        return
    known = {rival.alternative.spot for rival in name.rivals}
    for one in (one for one in new if one.spot not in known):
        yield Rival(one, np.nan, float(np.exp(min(odds, 0.0))), tuple(each for each in new if each is not one))


def smooth(state: State) -> list[int]:
    """Return the numbers of the random parts of a state that are smooth effects."""
    return [j for j, part in enumerate(state.random) if part.kind == SCATTER and effect_of(state, part).is_smooth]
