"""False and right names where readings have a realistic rest: a smooth random error of each tracer, image or axis.

python -m benchmarks smooth_rest [KIND ...] [COUNT [DRAWING]]
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.bars import Rate
from benchmarks.hidden import rates
from benchmarks.hidden.case import Case
from benchmarks.hidden.rest import DRAW, KINDS, Size
from metrocli.diagnosis.findings import Finding, RandomEffect

COUNT = 60
MOST_FALSE, LEAST_NAMED = 0.05, 0.90
_NAMED = 2.0
"""Size from which an effect is to be named"""


def main(arguments: list[str]) -> int:
    """Print the rates of one kind or of all; return 1 where a bar is not met."""
    kinds = [argument for argument in arguments if argument in KINDS] or list(KINDS)
    numbers = [int(argument) for argument in arguments if argument.isdigit()]
    count, draw = (*numbers, *(COUNT, DRAW)[len(numbers) :])[:2]
    met = True
    for kind in kinds:
        for size in KINDS[kind].sizes:
            print(f"-- {kind}, {size}, {count} measurements", flush=True)
            for rate in measured(KINDS[kind].cases(count, size, draw), size):
                print(rate, flush=True)
                met &= rate.met
    return 0 if met else 1


def measured(cases: Sequence[Case], size: Size) -> list[Rate]:
    """Return the rates of measurements with an effect of a size, or with none."""
    count, found = len(cases), [rates.found(case) for case in cases]
    named: list[tuple[Finding | RandomEffect, ...]] = [
        (*one.diagnosis.findings, *one.diagnosis.scatters) for one in found
    ]
    shown = [names for names in named if any(name.gain.shown for name in names)]
    structure = [one for one in found if one.diagnosis.left is not None or one.diagnosis.correlated_errors]
    if not size.times:
        return [
            Rate("false name", sum(map(bool, named)), count, most=MOST_FALSE),
            Rate("false name with a gain that is shown", len(shown), count, most=0.01),
            Rate("the rest noticed", len(structure), count),
        ]
    right = [one for one in found if rates.each_in_sets(one)]
    extra = [one for one, names in zip(found, named, strict=True) if len(names) > len(one.case.hidden)]
    covered = [hit for one in found for hit in one.covered]
    # what the bar can ask for: the power of a test of the effect alone that knows the covariance of all errors
    powers = [case.power for case in cases if case.power is not None]
    ideal = f" (by a test that knows the covariance: {np.mean(powers):.0%})" if powers else ""
    return [
        Rate(f"named{ideal}", len(right), count, least=LEAST_NAMED if size.times >= _NAMED else 0.0),
        Rate("  a further name, which is false", len(extra), count, most=MOST_FALSE),
        Rate("  95 % regions that hold the truth", sum(covered), len(covered), 0.92, 0.98),
    ]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
