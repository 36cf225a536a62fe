"""Stated sizes: how often an effect of its stated detectable size is found, and how often `hides` is exceeded.

For each case a measurement, an effect, its place, its direction among its parameters and the values of its scan are
drawn at random. Simulations are plain formulas that share nothing with the program (benchmarks/hidden). Counted are

- found: effects of exactly the stated detectable size that are noticed (bar: 72 to 88 %);
- hidden: changes of the result by just the stated `hides` that are not noticed (bar: at most 5 %);
- beyond: sizes that just stay unseen, at the non-centrality of 95 % power or, where the unknowns absorb the effect, at
  its largest usual size, that change the result by more than `hides` (bar: at most 5 %).

Noticed is an effect for which the verdict is not `clean`, or that is reported as a wrong reading. Each share has its
95 % binomial interval; a bar is missed where that interval lies beyond it.

    python -m benchmarks stated_sizes [KIND ...] [COUNT | FIRST-LAST]
"""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.bars import Rate
from benchmarks.hidden.subjects import KINDS, Planted
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.detectability import design, needed
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.findings import Verdict
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.linear.quadratics import quadratic

COUNT = 40
_ROUNDING = 1.01
"""Ratio from which a change is larger than another one"""
_SMALL = 0.1
"""Share of a size at which the change that is proportional to it is taken"""


@dataclass(frozen=True)
class Outcome:
    """What came of one effect at one place."""

    name: str
    found: bool | None
    """Whether it was noticed at its stated detectable size; None where none is stated"""
    hidden: bool | None
    """Whether it was not noticed where it changed the result by `hides`; None where it does not change the result"""
    beyond: float
    """Change of the result by a size that just stays unseen, over `hides`"""
    size: float
    """Stated detectable size, in plausible sizes"""


def outcome(kind: str, number: int) -> Outcome:
    """Return one seeded case."""
    rng = np.random.default_rng([77, list(KINDS).index(kind), number])
    name = KINDS[kind].effects[number % len(KINDS[kind].effects)]
    read = KINDS[kind].subject(rng, name)
    quiet = read(None, None)
    tests = measurement_of(quiet)
    stated = [one for one in design(State.of(tests)).candidates if one.alternative.effect.name == name]
    candidate = stated[int(rng.integers(len(stated)))]
    family = tests.families[candidate.family]
    forms = [a for a in family.alternatives if a.instance == candidate.alternative.instance]
    forms = [a for a in forms if a.effect.by == candidate.alternative.effect.by]
    form = forms[int(rng.integers(len(forms)))]
    at, count = family.alternatives.index(form), len(form.parameters)
    rank = int(quadratic(family.gram[[at]], np.zeros((1, count)), family.raw[[at]])[1][0])
    direction = rng.normal(size=count)
    direction /= np.linalg.norm(direction)

    def planted(size: float) -> Planted:
        values = dict(form.scanned) | dict(zip(form.parameters, (size * direction).tolist(), strict=True))
        if name == "screw-pitch-error":
            values |= {"amplitude": size, "phase": float(np.arctan2(direction[1], direction[0]))}
        return Planted(name, form.where, values)

    start = _delivered(quiet)

    def moved(size: float) -> float:
        return float(np.linalg.norm(_delivered(read(planted(size), None)) - start, axis=1).max())

    def noticed(size: float) -> bool:
        found = diagnose(read(planted(size), rng))
        return found.verdict != Verdict.CLEAN or bool(found.outliers)

    least = candidate.detectable if candidate.testable else candidate.plausible
    if candidate.testable and rank:
        seen = np.linalg.norm(linearised(read(planted(least * _SMALL), None).model).residual) / _SMALL
        strength = float(np.sqrt(needed(tests, candidate.family, rank, 0.95)))
        farthest = max(candidate.plausible, least * strength / float(np.sqrt(needed(tests, candidate.family, rank))))
        just = min(least * strength / seen, farthest * np.sqrt(count))
    else:
        just = least
    found = noticed(least) if candidate.testable else None
    hides, hidden = candidate.undetected.size, None
    by_least = moved(least * _SMALL) / _SMALL
    if candidate.testable and by_least > 0:
        hidden = not noticed(least * hides / by_least)
    beyond = moved(just) / hides if hides > 0 else float("nan")
    return Outcome(str(candidate.alternative), found, hidden, beyond, least / candidate.plausible)


def _delivered(job: AdjustedJob) -> npt.NDArray[np.float64]:
    """Return what the job delivers, (members, columns)."""
    return job.delivered.of(lambda name: job.model.blocks[name].values[:, list(job.delivered.columns)])


def rates(outcomes: Iterable[Outcome]) -> list[Rate]:
    """Return the three shares."""
    listed = list(outcomes)
    found = [one.found for one in listed if one.found is not None]
    hidden = [one.hidden for one in listed if one.hidden is not None]
    beyond = [one.beyond > _ROUNDING for one in listed if np.isfinite(one.beyond)]
    return [
        Rate("found at exactly the stated detectable size", sum(found), len(found), 0.72, 0.88),
        Rate("not noticed where the result is off by `hides`", sum(hidden), len(hidden), 0.0, 0.05),
        Rate("just unseen, and the result is off by more than `hides`", sum(beyond), len(beyond), 0.0, 0.05),
    ]


def main(arguments: list[str]) -> int:
    """Print the shares of one kind or of all; return 1 where a bar is missed."""
    kinds = [argument for argument in arguments if argument in KINDS] or list(KINDS)
    numbers, verbose = range(COUNT), "-v" in arguments
    for argument in arguments:
        span = re.fullmatch(r"(?:(\d+)-)?(\d+)", argument)
        if span is not None:
            numbers = range(int(span[2])) if span[1] is None else range(int(span[1]), int(span[2]) + 1)
    missed = False
    for kind in kinds:
        before = time.process_time()
        outcomes = [outcome(kind, number) for number in numbers]
        if verbose:
            for one in outcomes:
                print(one, flush=True)
        print(f"-- {kind}, {(time.process_time() - before) / len(numbers):.1f} s of CPU time a case")
        for rate in rates(outcomes):
            print(rate, flush=True)
            low, high = rate.bounds
            missed |= low > rate.most or high < rate.least
    return int(missed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
