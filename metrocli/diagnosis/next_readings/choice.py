"""The choice of the next readings: one by one those that raise the power of the tests that are to be decided most.

Method: docs/algorithms/next-readings.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.detectability import Detectability
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.linear.distributions import power
from metrocli.diagnosis.next_readings.pool import KnownErrors, Pool, pool_of
from metrocli.diagnosis.next_readings.proposals import Proposal, proposals
from metrocli.diagnosis.next_readings.separation import chance_to_separate
from metrocli.diagnosis.power.average_power import DetectableCandidate
from metrocli.errors import UsageError
from metrocli.frozen import dataclass
from metrocli.words import suggestion

_LEVEL = 0.01
"""Level of the tests: whether an effect is needed beside another one, or is there at all"""
_RIVALS, _UNSEEN = 3, 3
"""Largest number of rivals of a finding, and of unseen candidates, that are aimed at together"""
_TRIED = 20
"""Largest number of unseen candidates that are looked at, those that hide most first"""
_HELPS = 0.01
"""Smallest rise of the mean power for which readings are proposed"""
_CERTAIN = 1000.0
"""Non-centrality beyond which the power is 1"""
_EVEN = 1e-6
"""Weight of ln(1 + lambda) beside the power, which decides where powers are equal"""

_EVERYWHERE = "it is sought at all places at once, and these readings show it"
_SINGLE = "it spoils one reading, and every reading is tested for it"


@dataclass(frozen=True)
class OpenQuestion:
    """A question that further readings shall decide."""

    why: str
    """In words: separates dead-path-drift LT2 from tracer-drift LT2; shows length-scale"""
    before: float
    """Power with the readings so far: to show an effect, or to leave one of two only"""
    after: float
    """Power with the proposed readings as well"""


@dataclass(frozen=True)
class NextReading:
    """A reading to make, with what it helps to decide."""

    proposal: Proposal
    why: str
    """The aim whose power it raises most"""
    power: float
    """Power of that aim with this reading and those before it"""


@dataclass(frozen=True)
class Next:
    """The next readings, in the order in which they help most, and what they decide."""

    readings: tuple[NextReading, ...]
    aims: tuple[OpenQuestion, ...]


@dataclass(frozen=True)
class _Test:
    """The F test of an effect, alone or beside a rival, with the readings so far."""

    why: str
    parameters: int
    sizes: Array
    """Sizes of the effect, whose columns are the first of the pool, (n,)"""
    now: Pool
    odds: float | None = None
    """Odds of the rival, which has the other columns of the pool; None for an effect alone"""

    def powers(self, pool: Pool, grams: Array) -> tuple[Array, Array]:
        """Return the power with amounts of information (k, q, q), and the non-centralities, (k,) each."""
        noncentrality = pool.noncentrality(grams, self.sizes)
        dof = max(pool.dof - len(pool.gram), 1)
        return power(_LEVEL, self.parameters, dof, np.minimum(noncentrality, _CERTAIN)), noncentrality

    def power(self, pool: Pool) -> float:
        """Return the power of the test, or the chance to leave the true one of an effect and its rival only."""
        if self.odds is None:
            return float(self.powers(pool, pool.gram[None])[0][0])
        # with the readings so far the rival is in the confidence set
        return chance_to_separate(self.now, pool, len(self.sizes), self.odds) if len(pool.made) else 0.0


def next_readings(diagnosis: Diagnosis, count: int) -> Next:
    """Return the readings that best tell apart what is indistinct, or show what cannot be seen."""
    job, known = diagnosis.job, KnownErrors.from_diagnosis(diagnosis)
    proposed = proposals(job)
    tests = list(_of_indistinct(diagnosis, proposed, known)) if proposed else []
    if not tests and proposed:
        unseen = sorted(
            filter(_is_unseen, diagnosis.design.candidates), key=lambda candidate: -candidate.undetected.size
        )
        tried = [_of_candidate(job, candidate.alternative, proposed, known) for candidate in unseen[:_TRIED]]
        # those that hide most come first: the first few that proposals can show are enough
        tests = [test for test in tried if _can_rise(test, count)][:_UNSEEN]
    return _chosen(tests, proposed, count)


def _can_rise(test: _Test, count: int) -> bool:
    """Return whether so many proposals can raise the power of a test."""
    most, _ = test.powers(test.now, test.now.gram + count * test.now.gains())
    return float(most.max()) - test.power(test.now) > _HELPS


def revealing(job: AdjustedJob, design: Detectability, wanted: str, count: int) -> Next:
    """Return the readings that best show an effect, written as `NAME` or `NAME:PLACE`, before anything is measured.

    Raises UsageError if the job has no such candidate.
    """
    known: dict[str, Candidate] = {}
    for candidate in design.candidates:
        # of several forms of a cause the usual one is first
        known.setdefault(_label(candidate.alternative), candidate.alternative)
    name, _, place = wanted.partition(":")
    label = f"{name}:{place.partition('=')[2]}"
    revealed = known.get(wanted) or known.get(label)
    if revealed is None:
        hint = suggestion(wanted, list(known)) if known else "this job has no candidates"
        reason = next(_reasons(design, name, place.rpartition("=")[2]), "")
        message = (
            f"is not a candidate here: {reason}"
            if reason
            else f"is not an effect that this measurement could have; {hint}"
        )
        raise UsageError(f"--reveal: '{wanted}' {message}")
    proposed = proposals(job)
    return _chosen([_of_candidate(job, revealed, proposed, KnownErrors())] if proposed else [], proposed, count)


def _reasons(design: Detectability, name: str, place: str) -> Iterator[str]:
    """Yield why an effect is not a candidate at a place, or at all places, though the kind has it."""
    missing = [untested for untested in design.not_tested if untested.effect.name == name]
    yield from (
        untested.reason for untested in missing if not (place and untested.where) or place in untested.where.values()
    )
    scatters = [scatter for scatter in design.scatters if scatter.effect.name == name]
    yield from (_EVERYWHERE if scatter.testable else scatter.reason for scatter in scatters)
    yield from (_SINGLE for reading in design.readings if reading.effect.name == name)


def _label(alternative: Candidate) -> str:
    return ":".join([alternative.effect.name, *alternative.instance])


def _is_unseen(candidate: DetectableCandidate) -> bool:
    return not candidate.testable or candidate.detectable > candidate.plausible


def _of_indistinct(diagnosis: Diagnosis, proposed: Sequence[Proposal], known: KnownErrors) -> Iterator[_Test]:
    """Yield for each finding and rival the test whether the finding is needed beside the rival."""
    named = [finding.effect for finding in diagnosis.findings]
    for effect in named:
        others = [other.alternative for other in named if other is not effect]
        for rival in effect.rivals[:_RIVALS]:
            why = f"separates {effect.alternative} from {rival}"
            pool = pool_of(
                diagnosis.job, proposed, [effect.alternative, rival.alternative], [*others, *rival.beside], known
            )
            yield _Test(why, int(effect.estimable.sum()), effect.values, pool, rival.odds)


def _of_candidate(job: AdjustedJob, alternative: Candidate, proposed: Sequence[Proposal], known: KnownErrors) -> _Test:
    """Return the test of an effect of its largest usual size, all its parameters alike."""
    count = len(alternative.parameters)
    # the length of the vector of sizes is the usual size
    sizes = np.full(count, alternative.effect.plausible / np.sqrt(count))
    return _Test(f"shows {alternative.words}", count, sizes, pool_of(job, proposed, [alternative], known=known))


def _chosen(tests: Sequence[_Test], proposed: Sequence[Proposal], count: int) -> Next:
    """Return so many proposals, each the one that raises the sum of powers most beside those before it."""
    before = [test.power(test.now) for test in tests]
    pools, readings = [test.now for test in tests], list[NextReading]()
    while pools and len(readings) < count:
        with_each = [t.powers(p, p.gram + p.gains()) for t, p in zip(tests, pools, strict=True)]
        reached = np.stack([powers for powers, _ in with_each])
        even = sum(np.log1p(noncentralities) for _, noncentralities in with_each)
        # far below the noise all powers are the level: then the information decides, not the order of the proposals
        best = int(np.argmax(reached.sum(axis=0) + _EVEN * even))
        so_far = [t.powers(p, p.gram[None])[0][0] for t, p in zip(tests, pools, strict=True)]
        most = int(np.argmax(reached[:, best] - so_far))
        pools = [pool.with_proposal(best) for pool in pools]
        readings.append(NextReading(proposed[best], tests[most].why, tests[most].power(pools[most])))
    after = [test.power(pool) for test, pool in zip(tests, pools, strict=True)]
    helps = sum(after) - sum(before) > _HELPS * len(tests)
    after = after if helps else before
    aims = (OpenQuestion(test.why, *powers) for test, *powers in zip(tests, before, after, strict=True))
    return Next(tuple(readings) if helps else (), tuple(aims))


def as_data(chosen: Next) -> dict[str, Any]:
    """Return the next readings as plain data."""
    return {
        "next": [
            {
                "do": reading.proposal.do,
                "where": dict(reading.proposal.where),
                "why": reading.why,
                "power": reading.power,
            }
            for reading in chosen.readings
        ],
        "next_aims": [{"why": aim.why, "before": aim.before, "after": aim.after} for aim in chosen.aims],
    }
