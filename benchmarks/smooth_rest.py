"""False and right names where readings have a realistic rest: a smooth random error of each tracer, image or axis.

python -m benchmarks smooth_rest [KIND ...] [COUNT]
"""

from __future__ import annotations

import sys

from benchmarks.hidden import rates
from benchmarks.hidden.rest import KINDS

COUNT = 60
TIMES = (0.0, 2.0, 4.0)
"""Sizes of the effect, in multiples of the smallest that is found beside white noise; 0 for nothing hidden"""
MOST_FALSE, LEAST_NAMED = 0.05, 0.90
_NAMED = 2.0
"""Size from which an effect is to be named"""


def main(arguments: list[str]) -> int:
    """Print the rates of one kind or of all; return 1 where a bar is not met."""
    kinds = [argument for argument in arguments if argument in KINDS] or list(KINDS)
    count = next((int(argument) for argument in arguments if argument.isdigit()), COUNT)
    met = True
    for kind in kinds:
        print(f"-- {kind}, {count} measurements each", flush=True)
        for times in TIMES:
            for rate in measured(kind, count, times):
                print(rate, flush=True)
                met &= rate.met
    return 0 if met else 1


def measured(kind: str, count: int, times: float) -> list[rates.Rate]:
    """Return the rates of measurements with an effect of so many times its smallest size, or with none."""
    found = [rates.found(case) for case in KINDS[kind].cases(count, times)]
    shown = [one for one in found if any(finding.gain.shown for finding in one.diagnosis.findings)]
    structure = [one for one in found if one.diagnosis.left is not None or one.diagnosis.processes]
    if not times:
        return [
            rates.Rate("false name", sum(bool(one.diagnosis.findings) for one in found), count, most=MOST_FALSE),
            rates.Rate("false name with a gain that is shown", len(shown), count, most=0.01),
            rates.Rate("the rest noticed", len(structure), count),
        ]
    right = [one for one in found if rates.each_in_sets(one)]
    extra = [one for one in found if len(one.diagnosis.findings) > len(one.case.hidden)]
    covered = [hit for one in found for hit in one.covered]
    return [
        rates.Rate(f"named: {times:g}x", len(right), count, least=LEAST_NAMED if times >= _NAMED else 0.0),
        rates.Rate("  a further name, which is false", len(extra), count, most=MOST_FALSE),
        rates.Rate("  95 % regions that hold the truth", sum(covered), len(covered), 0.92, 0.98),
    ]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
