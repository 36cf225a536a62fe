"""Hidden effects: how often `diagnose` names what is in the readings, and how often what is not.

Cases are seeded and simulated by plain formulas (benchmarks/hidden). Sizes are multiples of the least size that is
found with 80 % power. Each rate has its 95 % binomial interval, and the bar that it is held against.

    python -m benchmarks hidden_effects [KIND] [COUNT]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator

from benchmarks.hidden import grids, images, launch, lengths, machine, rates
from benchmarks.hidden.case import Case, Found

KINDS: dict[str, Callable[[int], Iterator[Case]]] = {
    "multilaterate": lengths.cases,
    "calibrate-camera": images.calibrations,
    "align-part": images.alignments,
    "locate-launch-unit": launch.cases,
    "selfcal-grid": grids.cases,
    "calibrate-machine": machine.cases,
}
COUNT = 600


def results(kind: str, count: int) -> list[Found]:
    """Return the diagnoses of so many cases."""
    return [rates.found(case) for case in KINDS[kind](count)]


def main(arguments: list[str]) -> int:
    """Print the rates of one kind or of all; return 1 where a bar is not met."""
    kinds = [argument for argument in arguments if argument in KINDS] or list(KINDS)
    count = next((int(argument) for argument in arguments if argument.isdigit()), COUNT)
    met = True
    for kind in kinds:
        print(f"-- {kind}, {count} cases", flush=True)
        met &= rates.print_rates(results(kind, count))
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
