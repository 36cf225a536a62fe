"""Next readings: do the proposed ones separate two causes as often as predicted, and more often than random ones?

Networks of tracers with one hidden effect, simulated by plain formulas (benchmarks/hidden/lengths.py), until so many
diagnoses are indistinct. The five readings that `diagnose --next 5` proposes are simulated with noise of their own and
added, and the job is diagnosed again; likewise five proposals at random. The causes are separated if the first rival is
no longer in the confidence set of what is named, and the hidden effect still is. The chance that is predicted is held
against the share that is separated, for proposed and random readings.

    python -m benchmarks next_readings [COUNT [SEED]]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from benchmarks.hidden import lengths
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.findings import Diagnosis, Verdict
from metrocli.diagnosis.next_readings.choice import next_readings
from metrocli.diagnosis.next_readings.pool import KnownErrors, pool_of
from metrocli.diagnosis.next_readings.proposals import Proposal, proposals
from metrocli.diagnosis.next_readings.separation import chance_to_separate
from metrocli.effects.effect import ELAPSED, WARMING

COUNT, READINGS, SEED = 20, 5, 79
_BINS = (0.0, 0.2, 0.5, 0.9, 1.0)
"""Bounds of the predicted chances that are held together against what is reached"""
_NAMES = ("dead-path-drift", "tracer-drift", "tracer-scale", "refraction-drift")
_POINTS, _MOST = 40, 400


@dataclass(frozen=True)
class Case:
    """An indistinct measurement: what is hidden, what was found, and what is proposed."""

    measurement: lengths.Measurement
    change: lengths.Signature
    """Change of the readings by the hidden effect"""
    name: str
    diagnosis: Diagnosis


def cases(count: int, seed: int = SEED) -> Iterator[Case]:
    """Yield so many measurements with one finding and a rival, of which one is the hidden effect."""
    found = 0
    for number in range(_MOST):
        if found == count:
            return
        rng = np.random.default_rng([seed, number])
        m = lengths.measurement(rng, _POINTS)
        name = _NAMES[number % len(_NAMES)]
        at = int(rng.integers(len(m.tracers)))
        values = {"rate": 1e-6, "scale": 1e-6, "by": 0.0} | dict.fromkeys(("vx", "vy", "vz"), 1e-6)
        taken = lengths.absorbed_by(m)
        shape = lengths.signature(name, at, values)(m)
        factor = rng.uniform(4, 7) / float(np.linalg.norm(lengths.visible(m, taken, shape[:, None])))
        change = lengths.signature(
            name, at, {key: value * factor if key != "by" else value for key, value in values.items()}
        )
        m = replace(m, length=m.length + change(m))
        diagnosis = diagnose(m.adjusted())
        if (
            diagnosis.verdict is Verdict.INDISTINCT
            and len(diagnosis.findings) == 1
            and _is_one_of_two(diagnosis, name, at)
        ):
            found += 1
            yield Case(m, change, name, diagnosis)


def _is_one_of_two(diagnosis: Diagnosis, name: str, at: int) -> bool:
    """Return whether the hidden effect is what is named, or its first rival."""
    effect = diagnosis.findings[0].effect
    spots = {effect.alternative.spot, effect.rivals[0].alternative.spot}
    return bool(spots & {(name, (f"T{at}",)), (name, ())})


def separated(case: Case, made: Sequence[Proposal], rng: np.random.Generator) -> tuple[bool, Verdict]:
    """Return whether one of the two likeliest causes is left after readings are made, and the verdict with them."""
    found = diagnose(measured(case, made, rng).adjusted())
    before = case.diagnosis.findings[0].effect
    rival = before.rivals[0].alternative.spot
    spots = {before.alternative.spot, rival}
    left = set()
    for finding in found.findings:
        one = finding.effect
        left |= {one.alternative.spot, *(other.alternative.spot for other in one.rivals)} & spots
    return len(left) == 1 and next(iter(left))[0] == case.name, found.verdict


def measured(case: Case, made: Sequence[Proposal], rng: np.random.Generator) -> lengths.Measurement:
    """Return the measurement with the readings of proposals, with the hidden effect and noise of their own."""
    m = case.measurement
    if not made:  # no reading helps
        return m
    added = [(one, observations) for one in made for observations in one.added.values()]
    point = np.array([int(one.where["point"][1:]) for one, _ in added], dtype=int)
    tracer = np.array([int(one.where["tracer"][1:]) for one, _ in added], dtype=int)
    t = m.t.min() + np.array([float(o.conditions[ELAPSED][0]) for _, o in added])
    temp = m.temp[np.argmin(m.t)] + np.array([float(o.conditions[WARMING][0]) for _, o in added])
    whole = replace(
        m,
        point=np.concatenate([m.point, point]),
        tracer=np.concatenate([m.tracer, tracer]),
        t=np.concatenate([m.t, t]),
        temp=np.concatenate([m.temp, temp]),
        length=np.concatenate([m.length, np.zeros(len(point))]),
    )
    change = case.change(whole)
    # the mean over so many readings is the dead path to a fraction of their noise
    dead = np.array([np.mean((m.distance + case.change(m) - m.length)[m.tracer == j]) for j in range(len(m.tracers))])
    new = (whole.distance - dead[whole.tracer] + change + rng.normal(size=len(change)) * whole.sigma)[-len(point) :]
    return replace(whole, length=np.concatenate([m.length, new]))


def main(arguments: list[str]) -> int:
    """Print predicted and achieved shares; return 1 where the proposed readings achieve 0.1 less than predicted."""
    numbers = [int(word) for word in arguments if word.isdigit()]
    count, seed = [*numbers, *(COUNT, SEED)[len(numbers) :]][:2]
    proposed: list[tuple[float, bool]] = []
    random: list[tuple[float, bool]] = []
    before, verdicts = time.process_time(), list[Verdict]()
    for number, case in enumerate(cases(count, seed)):
        rng = np.random.default_rng([seed + 1, number])
        found = next_readings(case.diagnosis, READINGS)
        all_of_them = proposals(case.diagnosis.job)
        some = [all_of_them[i] for i in rng.choice(len(all_of_them), READINGS, replace=False)]
        apart, verdict = separated(case, [one.proposal for one in found.readings], rng)
        proposed.append((found.aims[0].after, apart))
        apart, other = separated(case, some, rng)
        random.append((predicted(case, some), apart))
        verdicts += [verdict, other]
        print(
            f"{case.name:18} {found.aims[0].why}: {_words('proposed', *proposed[-1])}, {verdict}; "
            f"{_words('random', *random[-1])}, {other}",
            flush=True,
        )
    print(f"{len(proposed)} indistinct cases, {(time.process_time() - before):.0f} s of CPU time")
    for name, pairs in (("proposed", proposed), ("random", random)):
        chances, reached = np.array(pairs).T
        print(f"{name} readings: {chances.mean():.2f} predicted in the mean, {reached.mean():.2f} separated")
        for low, high in pairwise(_BINS):
            inside = (chances >= low) & ((chances < high) | (high == 1))
            if inside.any():
                mean, share = chances[inside].mean(), reached[inside].mean()
                print(f"  {low} to {high}: {inside.sum():3} cases, {mean:.2f} predicted, {share:.2f} separated")
    left = sum(one is Verdict.UNEXPLAINED for one in verdicts)
    print(f"unexplained with the added readings: {left} of {len(verdicts)} diagnoses")
    chances, reached = np.array(proposed).T
    return int(reached.mean() < chances.mean() - 0.1)


def _words(which: str, chance: float, reached: bool) -> str:
    return f"{which} {chance:.2f} {'separated' if reached else 'not separated'}"


def predicted(case: Case, made: Sequence[Proposal]) -> float:
    """Return the chance that readings separate the cause that is named from its first rival."""
    effect = case.diagnosis.findings[0].effect
    rival = effect.rivals[0]
    known = KnownErrors.from_diagnosis(case.diagnosis)
    now = then = pool_of(case.diagnosis.job, made, [effect.alternative, rival.alternative], (), known)
    for number in range(len(made)):
        then = then.with_proposal(number)
    return chance_to_separate(now, then, len(effect.values), rival.odds)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
