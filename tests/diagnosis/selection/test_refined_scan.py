"""A scan that was coarse finds its value all the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.hidden import lengths
from metrocli.diagnosis.diagnose import diagnose
from metrocli.effects.effect import Effect


def coarse(effect: Effect) -> Effect:
    return replace(effect, scanned=tuple(replace(one, tried=8) for one in effect.scanned))


def test_the_time_of_a_jump_is_found_between_the_times_that_were_tried() -> None:
    m = lengths.measurement(np.random.default_rng(21), 60)
    at = float(np.sort(np.unique(m.t))[33]) - 1e-3
    m = replace(m, length=m.length + lengths.signature("dead-path-jump", 2, {"step": 2e-3, "at": at})(m))
    adjusted = m.adjusted()
    effects = tuple(coarse(effect) for effect in adjusted.effects)
    tried = [dict(f.effect.alternative.scanned)["at"] for f in diagnose(replace(adjusted, effects=effects)).findings]
    times = np.unique(m.t)
    assert len(tried) == 1
    assert times[32] < tried[0] < times[33]
