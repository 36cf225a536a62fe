"""Time of `diagnose`: 100 points and six tracers in 5 s, 4,000 image coordinates in 60 s; CPU seconds, one thread.

The adjustment before it is not counted, and printed beside it. Much structure: radial distortion of 100 times the size
that is found, an effect of no table and 1 % wrong coordinates, so that the job is diagnosed again with the first.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.hidden import images, lengths
from benchmarks.hidden.images import Images
from benchmarks.hidden.scenes import board_scene
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose

LENGTHS, COORDINATES = 5.0, 60.0
"""CPU seconds allowed"""


def measurements() -> Iterator[tuple[str, Callable[[], AdjustedJob], float]]:
    """Yield what is diagnosed, in words, with the seconds allowed."""
    rng = np.random.default_rng(7)
    plain = lengths.measurement(rng, 100)
    yield "100 points, 6 tracers: nothing hidden", plain.adjusted, LENGTHS
    drift, _ = lengths.planted(plain, rng, "tracer-drift", 3.0)
    yield "  an effect of 3x, 2 % wrong lengths", lengths.spoilt(drift, rng, 0.02)[0].adjusted, LENGTHS
    read = images.read(board_scene(rng, 29, (10, 8)).without(("k2",)), rng)
    yield f"{read.uv.size} image coordinates of a board: nothing hidden", read.adjusted, COORDINATES
    yield "  an effect of 3x", _planted(read, rng, "axis-skew", 3.0).adjusted, COORDINATES
    much, _ = images.unknown(_planted(read, rng, "radial-distortion", 100.0), rng, "_six-lobe", 10.0)
    yield "  much structure", images.spoilt(much, rng, 0.01)[0].adjusted, COORDINATES


def _planted(read: Images, rng: np.random.Generator, name: str, times: float) -> Images:
    made = images.planted(read, rng, name, times)
    if made is None:
        raise RuntimeError(f"nothing of {name} shows")
    return made[0]


def main() -> int:
    """Print the times; return 1 where one is beyond what is allowed."""
    met = True
    for what, job, allowed in measurements():
        start = time.process_time()
        adjusted = job()
        adjusted = time.process_time()
        found = diagnose(adjusted)
        seconds = time.process_time() - adjusted
        met &= seconds <= allowed
        names = ", ".join(str(finding.effect.alternative) for finding in found.findings) or "no name"
        printed = f"{found.verdict}: {names}; {len(found.outliers)} wrong"
        print(f"{what:52} {seconds:6.2f} s (adjusted in {adjusted - start:.2f} s)  allowed {allowed:.0f} s  {printed}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
