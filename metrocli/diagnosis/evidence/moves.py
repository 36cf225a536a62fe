"""The moves of the search: what may enter a state, with its quick net gain.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import islice

import numpy as np

from metrocli.adjust.robust import SAME
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import CORRELATED, EFFECT, SCATTER, Fixed, Random
from metrocli.diagnosis.evidence.prices import ALIKE
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.evidence.variances import Found, correlated_errors, noisier_groups, scattered_effects
from metrocli.diagnosis.evidence.weights import tried_noise, with_noise
from metrocli.diagnosis.linear.projection import MOST_NUMBERS, READING
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.diagnosis.noise import AS_OTHERS, DECLARED_SIGMA
from metrocli.errors import InputError
from metrocli.frozen import dataclass

_CORRELATED = 4
"""Largest number of correlated errors: what more of them explain is small beside these"""
_AT_ONCE = 60
"""Wrong readings of one step, at most"""
_APART = 0.3
"""Largest correlation of wrong readings that are taken in one step"""
_ESTIMATES, _STAYS = 8, 1.03
"""Largest number of estimates of the noise of a group, and the ratio of two that ends them"""
_NOISES = 1e-3, 1e6
"""Least and largest noise of a group relative to the others: the weight of exact readings would be infinite"""
_SHRINKS = 0.7
"""Largest factor by which steps of estimates are taken to shrink"""
_NEARLY_NOISIER = AS_OTHERS**0.5
"""Ratio from which a group is watched: beside those that enter, the noise of the others is smaller"""
_STALE = 2.0
"""Gain from which the noise of a group is estimated anew: that of the others has changed since"""
_MASKED, _TOGETHER = 2.0, 8
"""Variance of the noise, in that declared, from which several wrong readings are sought together, and how many"""


@dataclass(frozen=True)
class Move:
    """Parts that may enter, with their quick net gain."""

    net: float
    fixed: tuple[Fixed, ...] = ()
    entering: Found | None = None
    noise: Mapping[int, float] | None = None
    given: bool = False
    """Whether the noise is that of prior values, whose stated sigma is wrong"""
    watched: tuple[int, ...] = ()
    """Groups of the same kind, which enter with these if they are noisier beside them: no other move pays"""

    @property
    def is_cause(self) -> bool:
        """Whether known effects enter, at a place or at all their places."""
        return any(part.sort == EFFECT for part in self.fixed) or (
            self.entering is not None and self.entering.kind == SCATTER
        )

    @property
    def has_correlated(self) -> bool:
        """Whether a correlated error enters, of all readings or of any unit."""
        return self.entering is not None and self.entering.kind == CORRELATED

    @property
    def is_correlated(self) -> bool:
        """Whether an error of all readings, or of each unit, enters that is correlated over a covariate."""
        return self.entering is not None and self.entering.kind == CORRELATED and self.entering.key[2] < 0

    @property
    def keys(self) -> tuple[tuple[int, ...], ...]:
        """Keys of the parts that enter."""
        return (*(part.key for part in self.fixed), *(() if self.entering is None else (self.entering.key,)))

    def is_like(self, part: Fixed | Random) -> bool:
        """Return whether a part enters, or a correlated error over the same covariate of another length."""
        if not isinstance(part, Random):
            return part.key in self.keys
        if self.entering is None or self.entering.kind != part.kind:
            return False
        return self.entering.key[0] == part.key[0] if part.kind == CORRELATED else self.entering.key == part.key

    def tried(self, state: State) -> tuple[float, Callable[[], State]]:
        """Return the score of the state after the move, and what makes that state.

        Other noise weights all candidates anew, which is left until the move is chosen.
        """
        if self.noise is not None:
            score, ratios = _settled(state, self.noise, self.watched)
            return score, lambda: state.at(with_noise(state.measurement, ratios)) if ratios else state
        made = self.made(state)
        return made.score, lambda: made

    def made(self, state: State) -> State:
        """Return the state after the move."""
        if self.noise is not None:
            return self.tried(state)[1]()
        if self.entering is not None:
            return state.plus(random=[self.entering.part(state.measurement)], logs=[self.entering.log])
        return state.plus(self.fixed)


def _settled(state: State, noise: Mapping[int, float], watched: Sequence[int]) -> tuple[float, dict[int, float]]:
    """Return the score with the noise of variance groups, estimated until it stays, and their ratios.

    Groups that have a noise of their own already are estimated anew with them, since the noise of the others changes.
    """
    # with no noise before, the first estimate is taken in any case; with some, the new one must not be worse
    known = state.measurement.noise
    best, logs = state.score if known else -np.inf, state.logs
    held, before = dict[int, float](), dict[int, float]()
    tried = {**dict.fromkeys(known, 1.0), **noise}
    for _ in range(_ESTIMATES):
        tried = {number: float(np.clip(r, *np.divide(_NOISES, known.get(number, 1.0)))) for number, r in tried.items()}
        trial = tried_noise(state, tried, [number for number in watched if number not in tried], logs)
        if trial.score < best:
            break
        change = {number: float(np.log(trial.ratios[number] / ratio)) for number, ratio in tried.items()}
        best, held, logs = trial.score, tried, trial.logs
        if not trial.others and all(abs(step) < np.log(_STAYS) for step in change.values()):
            break
        # an estimate goes only a part of the way, since the group had a say in the unknowns: the rest is added at once
        shrunk = {number: step / before[number] if before.get(number) else 0.0 for number, step in change.items()}
        tried = {
            number: ratio * float(np.exp(change[number] / (1 - np.clip(shrunk[number], 0.0, _SHRINKS))))
            for number, ratio in tried.items()
        } | trial.others
        before = change
    return best, held


def moves(state: State, quiet: set[int] | None = None) -> list[Move]:
    """Return what may enter a state, the best first, computed once; `quiet` are covariates that showed nothing before.

    Those that show nothing here are added to them.
    """
    quiet = set() if quiet is None else quiet
    if (key := ("moves", frozenset(quiet))) not in state.cache:
        possible = [*causes(state), *readings(state), *_masked_readings(state)]
        if sum(part.kind == CORRELATED for part in state.random) < _CORRELATED:
            possible += [Move(entering.net, entering=entering) for entering in correlated_errors(state, quiet)]
        possible += _noise(state, alone=all(move.net <= 0 for move in possible))
        # a little below 0 too: quick gains are at the present sizes, and may rise when these are estimated
        state.cache[key] = sorted((move for move in possible if move.net > -1), key=lambda move: -move.net), {*quiet}
    entering, silent = state.cache[key]
    quiet |= silent
    return list(entering)


def causes(state: State) -> list[Move]:
    """Return the effects, and unknown causes, of the largest net gains, and the best effect at all its places."""
    if "causes" not in state.cache:
        scattered = [Move(entering.net, entering=entering) for entering in scattered_effects(state)[:1]]
        state.cache["causes"] = [*effects(state), *scattered]
    return [*state.cache["causes"]]


def _noise(state: State, alone: bool) -> list[Move]:
    """Return the variance groups of one step that are noisier, of given values and of readings.

    They are the most certain, and those of its kind nearly as certain; all of its kind where no other move pays, which
    then stand `alone`.
    """
    kinds, known = [unit[0] for unit in state.measurement.units], state.measurement.noise
    # one of many units that is quieter than the others is not a cause for anything
    named = _by_effects(state.measurement)
    every = [group for group in noisier_groups(state) if group[2] <= 1 or group[1] in known or group[1] not in named]
    groups = [
        group
        for group in every
        if (group[0] > _STALE if group[1] in known else group[0] > 0)
        and (
            group[2] > AS_OTHERS
            or group[1] in known
            # a whole kind that is quieter is a wrong statement of the job, which can be corrected
            or (group[2] < 1 / AS_OTHERS and kinds[group[1]] in (READING, DECLARED_SIGMA))
        )
    ]
    noisier = []
    for given in (True, False):
        own = [group for group in groups if (kinds[group[1]] == DECLARED_SIGMA) == given]
        alike = [group for group in own if kinds[group[1]] == kinds[own[0][1]] and group[0] > own[0][0] / 2]
        if own:
            noise, kind = {number: ratio for _, number, ratio in alike}, kinds[own[0][1]]
            near = (number for _, number, ratio in every if alone and kinds[number] == kind and ratio > _NEARLY_NOISIER)
            others = tuple(number for number in near if number not in noise and number not in known)
            noisier.append(Move(own[0][0], noise=noise, given=given, watched=others))
    return noisier


def _by_effects(m: Measurement) -> set[int]:
    """Return the variance groups of given values whose larger noise an effect names, such as the return to stops."""
    every = (scatter[0].effect for scatter in m.scatters)
    blocks = {(m.job.model.places[key].index,) for effect in every if effect.noise for key in effect.keys}
    names = {group.name for group in m.job.model.groups if group.chain.blocks in blocks}
    return {number for number, (kind, name, _) in enumerate(m.units) if kind == DECLARED_SIGMA and name in names}


def effects(state: State, shared: bool = False) -> list[Move]:
    """Return the effects, and unknown causes, of the largest net gains; only the `shared` ones if asked.

    These act at no place of many, so that no random effect of all places can stand for them.

    Left out is what the error of one reading explains as well: beside its dead path, a jump after the first reading of
    a tracer is an error of that reading. How many readings there are is not evidence for the jump.
    """
    m = state.measurement
    taken = {m.alternative(part.key).form for part in (*state.named, *state.unknown)}
    candidates: list[tuple[float, int, int, float, float]] = []
    everywhere = {scatter[0].name for scatter in m.scatters} if shared else set()
    for family in (number for number, group in enumerate(m.families) if group.name not in everywhere):
        gain, price, explained = state.gains_of_family(family)
        net = gain - price
        for at in np.argsort(-net)[:4].tolist():
            if net[at] > -1 and gain[at] > 0 and m.alternative((family, at)).form not in taken:
                candidates.append((float(net[at]), family, at, float(explained[at]), float(gain[at])))
    candidates.sort(reverse=True)
    chosen = (entering for entering in candidates if not _is_of_one_reading(state, *entering[1:]))
    return [Move(net, (m.effect(family, at),)) for net, family, at, *_ in islice(chosen, 2)]


def _is_of_one_reading(state: State, family: int, number: int, explained: float, gain: float) -> bool:
    """Return whether the error of one reading changes what the state leaves as an alternative does.

    It does not where the rest, little beside a large error, is beyond chance: a pose that is off shows most in one of
    its readings.
    """
    m = state.measurement
    gains, rank, by_readings = state.of_readings()
    alike = (rank > 0) & (rank <= m.families[family].columns.parameters) & (by_readings > SAME * explained)
    alike &= gains > gain - ALIKE
    rows = m.places[alike]
    if not len(rows):
        return False
    gram, right = (products[number] for products in state.left(family))
    # pinv: a parameter that is not seen has no size
    whole = m.whole(family, number) @ (np.linalg.pinv(gram, hermitian=True) @ right)
    right = np.where(rows >= 0, state.seen(whole)[rows], 0.0)
    shared, _ = quadratic(state.of_rows(rows), right, np.ones(rows.shape))
    return bool(shared.max() > SAME * explained)


def readings(state: State) -> list[Move]:
    """Return the wrong readings of one step: the most certain, and others nearly as bad that it does not imitate."""
    m = state.measurement
    gain, price, t = state.gains_of_readings()
    net = gain - price
    taken = {part.number for part in state.readings}
    order = [i for i in np.argsort(-net)[:_AT_ONCE].tolist() if net[i] > 0 and i not in taken]
    chosen: list[Fixed] = []
    # four times in squares: half the test of the worst, below which a reading may be its shadow
    for i in (i for i in order if t[i] > t[order[0]] / 4):
        error = m.reading(i)
        if all(np.abs(m.correlation(other, error)).max(initial=0.0) < _APART for other in chosen):
            chosen.append(error)
    _must_be_held(state, len(chosen))
    return [Move(float(net[order[0]]), tuple(chosen))] if chosen else []


def _must_be_held(state: State, more: int) -> None:
    """Raise InputError if so many fixed columns need more memory than a diagnosis may take."""
    rows = state.measurement.system.rows
    if rows * (len(state.fixed) + more) > MOST_NUMBERS:
        raise InputError(
            f"diagnose finds more than {MOST_NUMBERS // rows} wrong readings and effects in {rows} readings: "
            "it fits them together, which needs too much memory\n"
            "run the job with `outliers: remove`, and take the readings of its table `rejected` out of the file"
        )


def _masked_readings(state: State) -> list[Move]:
    """Return the wrong readings that show only together: each of them passes for noise beside the others.

    They are sought where the noise is larger than declared: the worst is taken out, and so on.
    """
    if state.variance < _MASKED or state.random:
        return []
    best, at = state, state
    # a quarter: taking out more leaves so few readings that any others fit
    most = min(_TOGETHER, len(state.measurement.places) // 4)
    for _ in range(most):
        gain, _, t = at.gains_of_readings()
        worst = int(np.argmax(np.where(gain > 0, t, -np.inf)))
        if gain[worst] <= 0 or worst in {part.number for part in at.readings}:
            break
        at = at.plus([state.measurement.reading(worst)])
        # on beyond a step that lowers the score: of two wrong readings that mask each other only both raise it
        best = at if at.score > best.score else best
    new = best.fixed[len(state.fixed) :]
    return [Move(best.score - state.score, new)] if len(new) > 1 else []
