"""A machine whose carrier does not return to its places: is `repeatability` named, and is its size right?

Lengths from four stations that read at once, by plain formulas (benchmarks/hidden/stops.py): nothing hidden, a scatter
of once and twice the size that the design states, and one beside a declared repeatability that is too small.

    python -m benchmarks scattered_stops [COUNT [SEED]]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

import numpy as np

from benchmarks.bars import Rate
from benchmarks.hidden import stops
from metrocli.diagnosis.diagnose import diagnose, what_can_be_seen
from metrocli.diagnosis.findings import Diagnosis, RandomEffect

COUNT, SEED = 20, 470
_DECLARED = 1e-3
"""Declared repeatability [mm]; the true one is three times this"""


def named(diagnosis: Diagnosis) -> RandomEffect | None:
    """Return the scatter of the stops, if it is named."""
    return next((one for one in diagnosis.scatters if one.effect.name == "repeatability"), None)


def detectable(m: stops.Measurement, rng: np.random.Generator) -> float:
    """Return the standard deviation that the design states, of a measurement with nothing hidden."""
    (one,) = what_can_be_seen(m.read(rng, 0.0).adjusted()).scatters
    return one.detectable


def results(count: int, seed: int) -> Iterator[tuple[str, float, Diagnosis]]:
    """Yield the scenario, the true scatter beyond the declared one, and the diagnosis."""
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        m = stops.measurement(rng)
        least = detectable(m, rng)
        for scenario, scatter in (("nothing", 0.0), ("1x", least), ("2x", 2 * least)):
            yield scenario, scatter, diagnose(m.read(rng, scatter).adjusted())
        more = m.read(rng, 3 * _DECLARED)
        yield "declared a third", float(np.sqrt(8) * _DECLARED), diagnose(more.adjusted(_DECLARED))


def main(arguments: list[str]) -> int:
    """Print the rates; return 1 where a bar is missed."""
    count, seed = [int(one) for one in arguments] + [COUNT, SEED][len(arguments) :]
    before, found = time.process_time(), list(results(count, seed))
    rates = []
    for scenario, least, most in (
        ("nothing", 0.0, 0.05),
        ("1x", 0.7, 1.0),
        ("2x", 0.97, 1.0),
        ("declared a third", 0.97, 1.0),
    ):
        own = [diagnosis for one, _, diagnosis in found if one == scenario]
        rates.append(Rate(f"named: {scenario}", sum(named(one) is not None for one in own), len(own), least, most))
    others = sum(bool(one.findings) for _, _, one in found)
    rates.append(Rate("another effect named", others, len(found), most=0.05))
    sized = [(size, one) for _, size, diagnosis in found if size and (one := named(diagnosis)) is not None]
    held = sum(abs(one.std - size) < 1.96 * one.spread for size, one in sized)
    rates.append(Rate("95 % intervals that hold the size", held, len(sized)))
    print(*rates, sep="\n")
    print(f"CPU time a diagnosis: {(time.process_time() - before) / len(found):.1f} s")
    return 0 if all(rate.met for rate in rates) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
