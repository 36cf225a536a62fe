"""What a measurement can see at all: of each candidate what is visible, how large it must be, and what it can hide.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import CORRELATED, READINGS
from metrocli.diagnosis.evidence.prices import LEVEL
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.hidden_change import POWER, UndetectedBias, forms_for, hidden_by_readings, undetected_bias
from metrocli.diagnosis.linear.candidates import Candidate, NotTested
from metrocli.diagnosis.linear.distributions import noncentrality, single_level
from metrocli.diagnosis.linear.projection import Linearised
from metrocli.diagnosis.linear.quadratics import ranks_of, roots
from metrocli.diagnosis.linear.scans import thinned
from metrocli.diagnosis.linear.signatures import nonlinearity
from metrocli.diagnosis.power.average_power import (
    QUANTILE,
    DetectableCandidate,
    ScatterCandidate,
    scatter_candidates,
    size_found,
)
from metrocli.diagnosis.power.collinear import Pair, pairs_of
from metrocli.effects.effect import Effect
from metrocli.frozen import dataclass

LEAST_REDUNDANCY = 1e-3
"""Smallest redundancy of a reading whose error shows"""
_POWER = 0.8
"""Probability with which an effect of the least detectable size is found"""
_FORMS = 60
"""Largest number of forms of an effect (values of its scan) over which the power is averaged"""
BENT = 0.1
"""Second-order share of a change from which nothing is excluded to first order: a tilted sensor exceeds it beside
p1 and p2, which take up its first order; the other effects of lens and board stay below half of it"""
_NAMED_ABSORBERS = 3
_PART = 0.1
"""Fraction of the largest absorbed change below which an unknown is not named among those that absorb"""


@dataclass(frozen=True)
class WrongReading:
    """What error of a single reading is detected."""

    effect: Effect
    detectable: float
    """Median over all readings of the smallest error that is found, in their unit; inf if none shows its own error"""
    between: tuple[float, float]
    """The smallest and the largest of these errors over the readings that are checked"""
    undetected: UndetectedBias
    """Largest change of the delivered result by an error of one reading that is not found with 95 % power"""
    unchecked: int
    """Number of readings whose errors no other reading shows"""

    @property
    def testable(self) -> bool:
        """Whether any reading shows its own error."""
        return bool(np.isfinite(self.detectable))


@dataclass(frozen=True)
class Detectability:
    """What a measurement can detect."""

    candidates: tuple[DetectableCandidate, ...]
    not_tested: tuple[NotTested, ...]
    pairs: tuple[Pair, ...]
    readings: tuple[WrongReading, ...] = ()
    scatters: tuple[ScatterCandidate, ...] = ()
    structure: tuple[str, ...] = ()
    """Covariates of the correlated errors beside which all this holds"""


def design(state: State, noise: float = 1.0, by_law: Collection[tuple[str, tuple[str, ...]]] = ()) -> Detectability:
    """Return what a measurement can detect beside a state, for a noise in units of the declared one.

    `by_law` are cause and place of the effects for which a law of the state stands.
    """
    job = state.measurement.job
    every = (_candidate(state, *spot, noise) for spot in _spots(state))
    candidates = tuple(
        replace(candidate, by_law=candidate.alternative.spot in by_law, nonlinear=_is_nonlinear(state, candidate))
        for candidate in every
    )
    readings = tuple(_wrong_reading(state, e, noise) for e in job.effects if e.of_one_reading)
    pairs, scatters = tuple(pairs_of(state, candidates, noise)), scatter_candidates(state, noise)
    number = (part.key[0] for part in state.random if part.kind == CORRELATED)
    structure = tuple(dict.fromkeys(state.measurement.knots[knot].name for knot in number))
    return Detectability(candidates, tuple(state.measurement.not_tested), pairs, readings, scatters, structure)


def _wrong_reading(state: State, effect: Effect, noise: float) -> WrongReading:
    """Return the smallest detectable error of a reading, `sqrt(lambda / r) sigma` (Baarda 1968)."""
    m = state.measurement
    level, first = _level(m, READINGS), m.places[:, 0]
    redundancy = 1 - state.absorbed[first]
    checked = redundancy > LEAST_REDUNDANCY
    rows = m.places[checked]
    rows, rest = rows[rows >= 0], max(m.system.dof - 1, 1)
    # an error of a reading shows in its own residual by its redundancy only (Baarda)
    unit = noise / np.sqrt(np.maximum(1 - state.absorbed[rows], 1e-12))
    least = np.sqrt(noncentrality(level, 1, rest, _POWER)) * unit
    hidden = np.sqrt(noncentrality(level, 1, rest, POWER)) * unit
    # inf, not an empty list: the median of none is nan
    sizes = least * m.system.scale[rows] if len(rows) else np.array([np.inf])
    between = float(sizes.min()), float(sizes.max())
    hides = hidden_by_readings(m.job, m.system, rows, hidden)
    return WrongReading(effect, float(np.median(sizes)), between, hides, int((~checked).sum()))


def _spots(state: State) -> Iterable[tuple[int, Sequence[int]]]:
    """Yield for each form of a cause at each place the number of its family and those of its alternatives."""
    for number, family in enumerate(state.measurement.families):
        if family.unknown:
            continue
        forms: dict[tuple[str, tuple[str, ...], str], list[int]] = {}
        for at, alternative in enumerate(family.alternatives):
            forms.setdefault(alternative.form, []).append(at)
        for chosen in forms.values():
            yield number, chosen


def _candidate(state: State, family: int, chosen: Sequence[int], noise: float) -> DetectableCandidate:
    m = state.measurement
    own, gram = m.families[family], state.left(family)[0]
    ranks = ranks_of(roots(gram[list(chosen)], own.raw[list(chosen)]))
    traces = np.where(ranks > 0, np.einsum("kqq->k", gram[list(chosen)]), 0.0)
    # the form of median visibility stands for all: the best one of a scan would promise too much (docs/decisions/068)
    middle = int(np.argsort(traces, kind="stable")[len(traces) // 2])
    at, rank = chosen[middle], int(ranks[middle])
    alternative = own.alternatives[at]
    raw, bare = own.raw[at], own.gram[at]
    visible = float(np.sqrt(np.mean(np.maximum(np.diag(bare), 0.0) / np.where(raw > 0, raw, 1.0) ** 2)))
    share = float(np.trace(gram[at]) / np.trace(bare)) if rank and np.trace(bare) > 0 else 1.0
    size = _size_found(state, family, chosen, ranks, alternative) * noise if rank else float("inf")
    power = {int(q): needed(m, family, int(q), POWER) * noise**2 if q else 0.0 for q in np.unique(ranks)}
    # where even usual sizes stay unseen, the change is that of the size found with 95 % power
    # `size` is that of 80 % power, and sizes go with the root of the non-centrality
    # one that is never found, whatever its size, is at most as large as usual ones
    unseen = size * np.sqrt(power[rank] / needed(m, family, rank)) / noise if np.isfinite(size) else 0.0
    assumed = max(alternative.effect.plausible, unseen)
    farthest = np.sqrt(own.columns.parameters) * assumed / alternative.effect.plausible
    reach = np.array([(power[q], farthest) for q in ranks.tolist()])
    some = thinned(np.arange(float(len(chosen))), forms_for(m.system, own.columns.parameters)).astype(int)
    hides = undetected_bias(m.job, m.system, own, np.array(chosen)[some].tolist(), gram, reach[some])
    absorbers = () if rank else _absorbers(m.system, alternative.signature(m.system))
    missed = own.has_gaps(m.system, chosen)
    upper = _upper(state, family, at)
    required = bool((state.nets(family)[list(chosen)] > 0).any())
    return DetectableCandidate(
        alternative, family, at, visible, size, hides, assumed, absorbers, missed, upper, share, required
    )


def _is_nonlinear(state: State, candidate: DetectableCandidate) -> bool:
    """Return whether a candidate is not linear up to the size that would be excluded.

    Columns of the job's own blocks, such as terms of a lens, bend; what a link adds is linear itself.
    """
    own, m, size = candidate.alternative, state.measurement, max(candidate.detectable, candidate.upper)
    if own.effect.link is not None or own.instance or not size <= candidate.plausible:
        return False
    return nonlinearity(m.system, own.effect, dict(own.scanned), size) > BENT


def _upper(state: State, family: int, number: int) -> float:
    """Return the upper bound (97.5 %) of the size of an alternative that is not in a state.

    The size of several parameters is their length, as in `size_found`. The bound is `|theta| + 1.96 s`, with the
    estimate theta beside all else and the root mean square s of their standard deviations. Like the size that is found
    it is that of a usual direction, not of the least visible one.
    """
    gram, right = (values[number] for values in state.left(family))
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    seen = scale > 0
    if not seen.any():
        return float("inf")
    unit = gram[np.ix_(seen, seen)] / scale[seen] / scale[seen][:, None]
    inverse = np.linalg.pinv(unit, 1e-8, hermitian=True) / scale[seen] / scale[seen][:, None]
    theta = inverse @ right[seen]
    spread = np.sqrt(state.variance * max(float(np.mean(np.diag(inverse))), 0.0))
    return float(np.linalg.norm(theta) + QUANTILE * spread)


def _size_found(state: State, family: int, chosen: Sequence[int], ranks: Array, median: Candidate) -> float:
    """Return the size found with 80 % power, over the visible forms whose sizes mean the same as the median's."""
    m = state.measurement
    alternatives = m.families[family].alternatives
    own = (median.effect.by, median.parameters)
    forms = [i for i, at in enumerate(chosen) if (alternatives[at].effect.by, alternatives[at].parameters) == own]
    shown = thinned(np.array([i for i in forms if ranks[i] > 0]), _FORMS)
    grams = state.left(family)[0][np.array(chosen)[shown]]
    return size_found(grams, ranks[shown], _level(m, family), m.system.dof, _POWER)


def needed(m: Measurement, family: int, rank: int, power: float = _POWER) -> float:
    """Return the non-centrality at which an alternative of a family is found with a power as a first effect."""
    return noncentrality(_level(m, family), rank, max(m.system.dof - rank, 1), power)


def _level(m: Measurement, family: int) -> float:
    """Return the level of a single test of a family for a first effect."""
    return single_level(LEVEL, m.prices.tests[family])


def _absorbers(system: Linearised, full: Array) -> tuple[str, ...]:
    """Return, in words, the unknowns that absorb most of a signature."""
    change = np.abs(system.absorbed(full / np.maximum(np.linalg.norm(full, axis=0), 1e-300))) * system.sizes[:, None]
    taken: dict[str, float] = {}
    for name, places in system.layout.columns.items():
        block = system.model.blocks[name]
        for column, at in zip(block.columns, places.T, strict=True):
            if (at >= 0).any():
                words = f"{column} of {block.noun or name}" + ("s" if len(block.members) > 1 else "")
                taken[words] = float(np.sqrt((change[at[at >= 0]] ** 2).sum()))
    most = max(taken.values(), default=0.0)
    ranked = sorted(taken, key=lambda words: -taken[words])
    return tuple(words for words in ranked[:_NAMED_ABSORBERS] if taken[words] > _PART * most)
