"""The choice of the next readings: one by one those that raise the power of the tests that are to be decided most.

Method: docs/algorithms/next-readings.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.detectability import Candidate, Design
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.linear.candidates import Alternative
from metrocli.diagnosis.linear.distributions import power
from metrocli.diagnosis.linear.projection import System
from metrocli.diagnosis.linear.signatures import signature
from metrocli.diagnosis.next_readings.pool import Pool, Signature, pool_of
from metrocli.diagnosis.next_readings.proposals import Proposal, proposals
from metrocli.effects.model import Model
from metrocli.errors import UsageError
from metrocli.words import suggestion

LEVEL = 0.01
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


@dataclass(frozen=True)
class Aim:
    """A test that further readings shall decide."""

    why: str
    """In words: separates dead-path-drift LT2 from tracer-drift LT2; shows length-scale"""
    parameters: int
    before: float
    """Power with the readings so far"""
    after: float
    """Power with the proposed readings as well"""


@dataclass(frozen=True)
class NextReading:
    """A reading to make, with what it helps to decide."""

    proposal: Proposal
    why: str
    """The aim whose power it raises most"""
    power: float
    """Power of that test with this reading and those before it"""


@dataclass(frozen=True)
class Next:
    """The next readings, in the order in which they help most, and the tests that they decide."""

    readings: tuple[NextReading, ...]
    aims: tuple[Aim, ...]


def next_readings(diagnosis: Diagnosis, count: int) -> Next:
    """Return the readings that best tell apart what is indistinct, or show what cannot be seen."""
    job, noise = diagnosis.job, diagnosis.noise.ratio
    proposed = proposals(job)
    pools = list(_of_indistinct(diagnosis, proposed)) if proposed else []
    if not pools and proposed:
        unseen = sorted(filter(_is_unseen, diagnosis.design.candidates), key=lambda one: -one.hides.size)
        tried = [_of_candidate(job.model, one.alternative, proposed, noise) for one in unseen[:_TRIED]]
        pools = [one for one in tried if _can_rise(*one, count)][:_UNSEEN]
    return _chosen(pools, proposed, count)


def _can_rise(aim: Aim, pool: Pool, count: int) -> bool:
    """Return whether so many proposals can raise the power of a test."""
    most = pool.noncentrality + count * pool.gains().max()
    return float(_powers(aim, pool, np.array([most]))[0]) - _power(aim, pool) > _HELPS


def revealing(job: AdjustedJob, design: Design, wanted: str, count: int) -> Next:
    """Return the readings that best show an effect, written as `NAME` or `NAME:PLACE`, before anything is measured.

    Raises UsageError if the job has no such candidate.
    """
    name, _, place = wanted.partition(":")
    known = {_label(one.alternative): one.alternative for one in design.candidates}
    found = next((one for label, one in known.items() if label in (wanted, f"{name}:{place.partition('=')[2]}")), None)
    if found is None:
        hint = suggestion(wanted, list(known)) if known else "this job has no candidates"
        raise UsageError(f"--reveal: there is no effect '{wanted}' that this measurement could have; {hint}")
    proposed = proposals(job)
    return _chosen([_of_candidate(job.model, found, proposed, 1.0)] if proposed else [], proposed, count)


def _label(alternative: Alternative) -> str:
    return ":".join([alternative.effect.name, *alternative.instance])


def _is_unseen(candidate: Candidate) -> bool:
    return not candidate.testable or candidate.detectable > candidate.plausible


def _of_indistinct(diagnosis: Diagnosis, proposed: Sequence[Proposal]) -> Iterator[tuple[Aim, Pool]]:
    """Yield for each finding and rival the test whether the finding is needed beside the rival."""
    model, named = diagnosis.job.model, [finding.effect for finding in diagnosis.findings]
    for one in named:
        others = [other.alternative for other in named if other is not one]
        for rival in one.rivals[:_RIVALS]:
            aim = Aim(f"separates {one.alternative} from {rival.alternative}", int(one.seen.sum()), 0.0, 0.0)
            shown = _signature(one.alternative, one.values)
            yield aim, pool_of(model, proposed, [*others, rival.alternative], shown, diagnosis.noise.ratio)


def _of_candidate(
    model: Model, alternative: Alternative, proposed: Sequence[Proposal], noise: float
) -> tuple[Aim, Pool]:
    """Return the test of an effect of its largest usual size, all its parameters alike."""
    count = len(alternative.parameters)
    sizes = np.full(count, alternative.effect.plausible / np.sqrt(count))
    pool = pool_of(model, proposed, [], _signature(alternative, sizes), noise)
    return Aim(f"shows {alternative}", count, 0.0, 0.0), pool


def _signature(alternative: Alternative, sizes: Array) -> Signature:
    def found(model: Model, system: System) -> Array:
        full = signature(model, system, alternative.effect, alternative.instance, dict(alternative.scanned))
        return np.asarray(full @ sizes)

    return found


def _chosen(pools: Sequence[tuple[Aim, Pool]], proposed: Sequence[Proposal], count: int) -> Next:
    """Return so many proposals, each the one that raises the sum of powers most beside those before it."""
    aims = [replace(aim, before=_power(aim, pool)) for aim, pool in pools]
    left = [pool for _, pool in pools]
    found: list[NextReading] = []
    while pools and len(found) < count:
        gains = [pool.gains() for pool in left]
        reached = np.stack([_powers(a, p, p.noncentrality + g) for a, p, g in zip(aims, left, gains, strict=True)])
        even = sum(np.log1p(pool.noncentrality + gain) for pool, gain in zip(left, gains, strict=True))
        best = int(np.argmax(reached.sum(axis=0) + _EVEN * even))
        rises = [float(now[best]) - _power(aim, pool) for now, aim, pool in zip(reached, aims, left, strict=True)]
        most = int(np.argmax(rises))
        left = [pool.made(best) for pool in left]
        found.append(NextReading(proposed[best], aims[most].why, _power(aims[most], left[most])))
    aims = [replace(aim, after=_power(aim, pool)) for aim, pool in zip(aims, left, strict=True)]
    helps = sum(aim.after - aim.before for aim in aims) > _HELPS * len(aims)
    return Next(tuple(found) if helps else (), tuple(aims))


def _power(aim: Aim, pool: Pool) -> float:
    return float(_powers(aim, pool, np.array([pool.noncentrality]))[0])


def _powers(aim: Aim, pool: Pool, noncentralities: Array) -> Array:
    certain = np.minimum(noncentralities, _CERTAIN)
    return power(LEVEL, aim.parameters, max(pool.dof - aim.parameters, 1), certain)


def as_data(found: Next) -> dict[str, Any]:
    """Return the next readings as plain data."""
    return {
        "next": [
            {"do": one.proposal.do, "where": dict(one.proposal.where), "why": one.why, "power": one.power}
            for one in found.readings
        ],
        "next_aims": [{"why": one.why, "before": one.before, "after": one.after} for one in found.aims],
    }
