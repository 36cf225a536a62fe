"""A diagnosis of lengths from six tracers, one of which has a dead path that drifts; its value is the drift's rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.beside.work import Values, Work

RATE = 2e-6
"""mm/s"""


def ours(points: int) -> Work:
    """`diagnose` of an adjusted job."""
    from benchmarks.hidden import lengths
    from metrocli.diagnosis.diagnose import diagnose

    m = lengths.measurement(np.random.default_rng(points), points)
    drift = lengths.signature("dead-path-drift", 1, {"rate": RATE})(m)
    job = replace(m, length=m.length + drift).adjusted()

    def run() -> Values:
        found = diagnose(job)
        return [(float(size.value), float(size.std)) for one in found.findings[:1] for size in one.sizes]

    return run
