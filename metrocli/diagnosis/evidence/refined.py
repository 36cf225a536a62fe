"""Scanned parameters of identified effects, between the best value of a coarse scan and its neighbours.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.evidence.identified import Alias
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import Fixed
from metrocli.diagnosis.evidence.prices import ALIKE, gain_of_columns
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.candidates import Candidate, CandidateGroup
from metrocli.diagnosis.linear.column_parts import OwnColumns
from metrocli.diagnosis.linear.quadratics import quadratic
from metrocli.diagnosis.linear.scans import conditions_of, is_filled, thinned
from metrocli.effects.links.own import NoValueAtReadingError
from metrocli.frozen import dataclass

_TRIED = 40
_ROUNDS = 2
_APART = 0.02
"""How far off another value of a scan is that explains the readings as well, relatively"""
_NEAR, _STARTS, STARTS = 0.7, 5, 30
"""Values of a scan that explain at least this share of what its best one does are refined too

At most so many as an effect enters, and in the end: of evenly spaced readings tens of periods fit alike.
"""


def refined(state: State, entered: Collection[tuple[int, int]] | None = None) -> State:
    """Return the state with the scanned parameters of its effects at their best values beside all else.

    Of the effects `entered` just now those whose values between the tried ones differ: what a coarse value leaves would
    look like something else, as the readings between a step and its coarse time look wrong. The price of an effect
    stays that of the scan, which counts the values tried.
    """
    for _ in range(_ROUNDS):
        before = state
        for number in range(len(state.fixed)):
            part = state.fixed[number]
            # neither a wrong reading nor a term of a law has a family
            effect = None if part.family < 0 else state.measurement.alternative(part.key).effect
            if effect is None or (entered is not None and part.key not in entered):
                continue
            if entered is not None and not (effect.is_step or is_filled(effect)):
                continue
            for parameter in effect.scanned:
                if parameter.grid is not None:
                    state = _closer(state, number, parameter.name, STARTS if entered is None else _STARTS)
        if state is before:
            break
    return state


@dataclass(frozen=True)
class _Tried:
    """An alternative with what it explains beside a state, and its whole columns."""

    alternative: Candidate
    explained: float
    rank: int
    whole: Array


@dataclass(frozen=True)
class _Scan:
    """A scanned parameter of an effect, beside all else."""

    less: State
    part: Fixed
    name: str
    most: int = STARTS
    """Number of its values that are refined at most"""

    @property
    def family(self) -> CandidateGroup:
        """The family of the effect."""
        return self.less.measurement.families[self.part.family]

    def tried(self, alternative: Candidate) -> _Tried | None:
        """Return what an alternative explains; None if it has no value at some reading."""
        try:
            whole = alternative.signature(self.less.measurement.system)
        except NoValueAtReadingError:
            return None
        left = self.less.seen(whole)
        gram, right = whole.T @ left, whole.T @ self.less.residual
        (t,), (q,) = quadratic(gram[None], right[None], np.linalg.norm(whole, axis=0)[None])
        return _Tried(alternative, float(t), int(q), whole)

    def at(self, start: Candidate, value: float) -> _Tried | None:
        """Return what an alternative with another value of the parameter explains."""
        scanned = tuple((key, value if key == self.name else old) for key, old in start.scanned)
        return self.tried(replace(start, scanned=scanned))

    def value(self, tried: _Tried) -> float:
        """Return the value of the parameter."""
        return dict(tried.alternative.scanned)[self.name]

    def peaks(self) -> list[_Tried]:
        """Return the best value about each start, itself or between its neighbours in the scan."""
        peaks = []
        for start in self._starts():
            between = (self.at(start, value) for value in self._between(start).tolist())
            near = [trial for trial in (self.tried(start), *between) if trial is not None]
            peaks += [max(near, key=lambda trial: trial.explained)] if near else []
        return peaks

    def _starts(self) -> list[Candidate]:
        """Return the alternatives that differ in the parameter only and are nearly as good, the best first.

        Of neighbours in the scan only the better one is a start.
        """
        chosen = self.family.alternatives[self.part.number]
        alike = [i for i, other in enumerate(self.family.alternatives) if _differs_in(chosen, other, self.name)]
        alike.sort(key=lambda i: dict(self.family.alternatives[i].scanned)[self.name])
        gains = self.less.of_family(self.part.family)[0][alike]
        # -inf at both ends: the first and the last value of a scan can be peaks
        higher = np.concatenate([[-np.inf], gains, [-np.inf]])
        peaks = (gains >= higher[:-2]) & (gains >= higher[2:]) & (gains > _NEAR * gains.max(initial=0.0))
        ranked = sorted(np.flatnonzero(peaks).tolist(), key=lambda at: -gains[at])[: self.most]
        return [self.family.alternatives[alike[at]] for at in ranked]

    def _between(self, start: Candidate) -> Array:
        """Return values of the parameter between the tried neighbours of one."""
        parameter = next(p for p in start.effect.scanned if p.name == self.name)
        if parameter.grid is None:
            return np.zeros(0)
        # another form of the cause may have no such parameter: from a station on, in place of a time
        alike = (alternative for alternative in self.family.alternatives if alternative.like(start))
        tried = np.unique([dict(alternative.scanned)[self.name] for alternative in alike])
        own = dict(start.scanned)[self.name]
        low, high = tried[tried < own].max(initial=-np.inf), tried[tried > own].min(initial=np.inf)
        values = np.sort(parameter.grid(conditions_of(self.less.measurement.job.model)))
        inside = np.flatnonzero((values > low) & (values < high))
        # a step lies between two readings: values between these are all the same step
        if start.effect.is_step or not len(inside):
            return thinned(values[inside][values[inside] != own], _TRIED)
        # a grid can be coarser than the readings tell
        return np.interp(np.linspace(inside[0], inside[-1], _TRIED), np.arange(len(values)), values)

    def aliases(self, peaks: Sequence[_Tried], best: _Tried) -> list[Alias]:
        """Return the values of other peaks that fit as well, with their odds.

        Between two values of one broad peak the readings are explained as well.
        """
        if not is_filled(best.alternative.effect):
            return []
        aliases = []
        for peak in peaks:
            value, here = self.value(peak), self.value(best)
            if abs(value - here) > _APART * abs(here) and self._odds(peak, best) > -ALIKE:
                middle = self.at(best.alternative, (value + here) / 2)
                if middle is not None and self._odds(middle, best) < -ALIKE:
                    aliases.append((self.name, value, float(np.exp(self._odds(peak, best)))))
        return aliases

    def _odds(self, other: _Tried, best: _Tried) -> float:
        """Return ln of the odds of one value against another."""
        explained, rank = np.array([other.explained, best.explained]), np.array([other.rank, best.rank])
        gains = gain_of_columns(explained, rank, self.less.fit.squares, self.less.freedoms)
        return float(gains[0] - gains[1])


def _closer(state: State, number: int, name: str, most: int) -> State:
    """Return the state with one scanned parameter of an effect at its best value.

    The best value need not lie beside the best one of the scan: it lies beside one that is nearly as good.
    """
    part = state.fixed[number]
    less = state.beside(part)
    scan = _Scan(less, part, name, most)
    known = float(less.of_family(part.family)[0][part.number])
    held = _Tried(scan.family.alternatives[part.number], known, part.rank, np.zeros((0, 0)))
    peaks = scan.peaks()
    best = max(peaks, key=lambda each: each.explained, default=held)
    # a value that explains the same but for rounding would turn the state to and fro in each round
    best = best if best.explained > held.explained * (1 + 1e-9) else held
    others = tuple(alias for alias in part.aliases if alias[0] != name)
    aliases = (*others, *scan.aliases(peaks, best))
    if best is held:
        return state if aliases == part.aliases else state.with_fixed(number, replace(part, aliases=aliases))
    grown = _with_alternative(state.measurement, part.family, best.alternative, best.whole)
    new = replace(grown.effect(part.family, len(scan.family.alternatives)), aliases=aliases, price=part.price)
    return replace(state, measurement=grown).with_fixed(number, new)


def _differs_in(one: Candidate, other: Candidate, name: str) -> bool:
    """Return whether two alternatives of a cause differ in one scanned parameter at most."""
    others = [{key: value for key, value in each.scanned if key != name} for each in (one, other)]
    return one.like(other) and others[0] == others[1]


def _with_alternative(m: Measurement, number: int, alternative: Candidate, whole: Array) -> Measurement:
    """Return a measurement with one more alternative of a family, of whole columns; so has the one without weights."""
    family, seen = m.families[number], m.system.seen(whole)
    grown = replace(
        family,
        alternatives=(*family.alternatives, alternative),
        columns=family.columns.followed_by(whole),
        raw=np.concatenate([family.raw, np.linalg.norm(whole, axis=0)[None]]),
        gram=np.concatenate([family.gram, (seen.T @ seen)[None]]),
        whole={**family.whole, family.columns.count: OwnColumns(np.arange(len(whole)), whole)},
    )
    bare = m.unweighted and _with_alternative(m.unweighted, number, alternative, whole / m.weights[:, None])
    families = (*m.families[:number], grown, *m.families[number + 1 :])
    # with a cache of its own: in another branch of the search its number is that of another value
    return replace(m, families=families, unweighted=bare, cache={**m.cache}, columns={**m.columns})
