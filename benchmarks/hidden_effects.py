"""Hidden effects: how often `diagnose` names what is in the readings, and how often what is not.

Cases are seeded and simulated by plain formulas (benchmarks/hidden). Sizes are multiples of the least size that is
found with 80 % power. `six-dof` are lines of a laser along a machine, `calibrate-machine` its points. Each rate has its
95 % binomial interval, and the bar that it is held against; so has the longest time of a diagnosis.

    python -m benchmarks hidden_effects [KIND ...] [COUNT | FIRST-LAST] [SCENARIO]

    python -m benchmarks hidden_effects multilaterate 0-2519 "an effect of 1x"
    python -m benchmarks hidden_effects align-part 40000-40439 "nothing*"
"""

from __future__ import annotations

import fnmatch
import re
import sys
from collections.abc import Iterable
from functools import partial

from benchmarks.hidden import grids, images, launch, lengths, lines, machine, rates
from benchmarks.hidden.case import Campaign, Found

KINDS = {
    "multilaterate": Campaign(lengths.case, lengths.SCENARIOS),
    "calibrate-camera": Campaign(partial(images.case, "calibrate-camera"), images.SCENARIOS, longest=20.0),
    "align-part": Campaign(partial(images.case, "align-part"), images.SCENARIOS),
    "locate-launch-unit": Campaign(launch.case, launch.SCENARIOS),
    "selfcal-grid": Campaign(grids.case, grids.SCENARIOS, longest=20.0),
    "calibrate-machine": Campaign(machine.case, machine.SCENARIOS, longest=20.0),
    "six-dof": Campaign(lines.case, lines.SCENARIOS, longest=20.0),
}
COUNT = 600


def results(kind: str, numbers: Iterable[int], only: str = "", small: bool = False) -> list[Found]:
    """Return the diagnoses of cases, of one scenario or of all."""
    return [rates.found(case) for case in KINDS[kind].cases(numbers, only, small)]


def main(arguments: list[str]) -> int:
    """Print the rates of one kind or of all; return 1 where a bar is not met."""
    kinds = [argument for argument in arguments if argument in KINDS] or list(KINDS)
    numbers, only = range(COUNT), ""
    for argument in arguments:
        span = re.fullmatch(r"(?:(\d+)-)?(\d+)", argument)
        if span is not None:
            numbers = range(int(span[2])) if span[1] is None else range(int(span[1]), int(span[2]) + 1)
        elif argument not in KINDS:
            only = argument
    for kind in kinds:
        if only and not fnmatch.filter(KINDS[kind].scenarios, only):
            print(f"no scenario '{only}' of {kind}; there are: {', '.join(dict.fromkeys(KINDS[kind].scenarios))}")
            return 2
    met = True
    for kind in kinds:
        print(f"-- {kind}, cases {numbers.start} to {numbers.stop - 1}{only and ': ' + only}", flush=True)
        met &= rates.print_rates(results(kind, numbers, only), KINDS[kind].longest)
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
