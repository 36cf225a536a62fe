"""How time and memory grow: each kind of work at three sizes, a decade apart where that is feasible.

    python -m benchmarks growth [MODULE ...]

CPU seconds of one run in a process of its own, on one thread, and its peak memory. The exponent is that of the time
between the two larger sizes: 1 is linear. What is larger than the bar has its reason beside it.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

from benchmarks.peers import once


@dataclass(frozen=True)
class Growth:
    """A kind of work at growing sizes."""

    work: str
    module: str
    sizes: tuple[int, ...]
    bar: float = 1.1
    """Largest exponent"""
    why: str = ""
    """Why it is beyond linear"""


GROWTHS = (
    Growth("multilaterate, points x 4, from text", "lengths", (1_000, 10_000, 100_000)),
    Growth("calibrate-camera, views of 100 points", "cameras", (10, 100, 1_000)),
    Growth("adjust-network, points x 6 trackers", "stations", (200, 2_000, 20_000)),
    Growth("report-uncertainty, trials", "end_gauge", (100_000, 1_000_000, 10_000_000)),
    Growth("run with nothing to do, jobs", "idle", (50, 500, 5_000)),
    Growth("diagnose, points x 6 lengths", "diagnosis", (100, 1_000, 10_000)),
)


def main(arguments: list[str]) -> int:
    """Print a line for each kind of work; return 1 where a bar is not met."""
    missed = False
    for one in GROWTHS:
        if arguments and one.module not in arguments:
            continue
        runs = [once(sys.executable, one.module, "ours", size) for size in one.sizes]
        seconds = [float(run["seconds"]) for run in runs]
        power = math.log(seconds[-1] / seconds[-2]) / math.log(one.sizes[-1] / one.sizes[-2])
        missed |= power > one.bar
        each = zip(one.sizes, runs, strict=True)
        cells = ", ".join(f"{size:,}: {run['seconds']:.3g} s {run['megabytes']:.0f} MB" for size, run in each)
        met = "met" if power <= one.bar else "NOT MET"
        print(f"{one.work}: {cells}; exponent {power:.2f} <= {one.bar} {met} {one.why}".rstrip(), flush=True)
    return int(missed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
