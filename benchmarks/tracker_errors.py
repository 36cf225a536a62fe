"""Five errors of a tracker that calibrates a machine: are they named, or is what they do to the result stated?

Machines, places of the tracker, signs and noise are drawn at random (benchmarks/hidden/machine.py, plain formulas). An
error counts as covered if the diagnosis names it, alone or among alternatives, or if the candidate has a `hides` of at
least the error made: the largest change of a table between the readings with the error and without it, under the same
noise. Bar: 95 % of the draws of each error. Other names than the right one are counted as wrong names.

    python -m benchmarks tracker_errors [COUNT | FIRST-LAST] [NAME]
"""

from __future__ import annotations

import re
import sys
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from benchmarks.bars import Rate
from benchmarks.hidden import machine
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.status import status

COUNT = 100
_ARCSEC = np.pi / 180 / 3600
ERRORS: dict[str, dict[str, float]] = {
    "tracker-range-zero": {"r0": 0.05},
    "tracker-beam-offset": {"h": 0.1 / np.sqrt(2), "v": 0.1 / np.sqrt(2)},
    "tracker-transit-tilt": {"angle": 10 * _ARCSEC},
    "tracker-vertical-index": {"angle": 10 * _ARCSEC},
    "tracker-azimuth-harmonic": {"c2": 5 * _ARCSEC / np.sqrt(2), "s2": 5 * _ARCSEC / np.sqrt(2)},
}
"""Errors and their sizes [mm, rad]: 50 um, 100 um, 10 arcsec, 10 arcsec, 5 arcsec"""


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis concludes on one error."""

    verdict: str
    status: str
    """named, excluded, cannot-see or not-testable"""
    made: float
    """Largest change of the tables by the error [mm]"""
    hides: float
    """What the candidate can hide [mm]"""
    wrong: tuple[str, ...]
    """Effects that are named without the right one among their alternatives"""

    @property
    def covered(self) -> bool:
        """Whether it is named, or `hides` covers it."""
        return self.status == "named" or self.made <= self.hides


def outcome(name: str, number: int, size: tuple[int, int] = machine.SIZE) -> Outcome:
    """Return one seeded draw of an error."""
    rng = np.random.default_rng([78, list(ERRORS).index(name), number])
    quiet = machine.measurement(rng, size)
    values = {key: value * float(rng.choice([-1, 1])) for key, value in ERRORS[name].items()}
    loud = replace(quiet, read=quiet.read + machine.change(quiet, name, {}, values)).adjusted()
    made = float(np.linalg.norm(tables(loud) - tables(quiet.adjusted()), axis=1).max())
    diagnosis = diagnose(loud)
    names = [one.effect for one in diagnosis.findings]
    (candidate,) = (one for one in diagnosis.design.candidates if one.alternative.effect.name == name)
    sets = [{one.alternative.effect.name, *(r.alternative.effect.name for r in one.rivals)} for one in names]
    wrong = tuple(str(one.alternative) for one, known in zip(names, sets, strict=True) if name not in known)
    return Outcome(diagnosis.verdict, status(candidate, diagnosis.conclusions), made, candidate.undetected.size, wrong)


def tables(job: AdjustedJob) -> npt.NDArray[np.float64]:
    """Return what the calibration delivers, (knots, components)."""
    delivered = job.delivered
    return np.concatenate([job.model.blocks[name].values[:, list(delivered.columns)] for name in delivered.blocks])


def _counted(words: Iterable[str]) -> str:
    return ", ".join(f"{word} {count}" for word, count in Counter(str(word) for word in words).most_common())


def main(arguments: list[str]) -> int:
    """Print a line for each error; return 1 where a bar is missed."""
    numbers = range(COUNT)
    for argument in arguments:
        span = re.fullmatch(r"(?:(\d+)-)?(\d+)", argument)
        if span is not None:
            numbers = range(int(span[2])) if span[1] is None else range(int(span[1]), int(span[2]) + 1)
    missed = False
    for name in [one for one in arguments if one in ERRORS] or list(ERRORS):
        before = time.process_time()
        found = [outcome(name, number) for number in numbers]
        seconds = (time.process_time() - before) / len(found)
        verdicts, words = (_counted(getattr(one, what) for one in found) for what in ("verdict", "status"))
        made, hides = (1e3 * np.median([getattr(one, what) for one in found]) for what in ("made", "hides"))
        print(f"-- {name}: {verdicts}; {words}, {seconds:.1f} s of CPU time a draw")
        print(f"error made {made:.3g} um, hides {hides:.3g} um (medians)")
        rate = Rate("named, or `hides` covers the error made", sum(one.covered for one in found), len(found), 0.95, 1.0)
        print(rate)
        print(Rate("another effect is named", sum(bool(one.wrong) for one in found), len(found), 0.0, 0.05), flush=True)
        missed |= rate.bounds[1] < rate.least
        for wrong, count in Counter(name for one in found for name in one.wrong).most_common(3):
            print(f"  named instead: {wrong} ({count})")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
