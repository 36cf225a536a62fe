"""The odds of a rival are those of the score: of the state with it in the place of the identified effect."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.hidden import lengths
from metrocli.diagnosis.evidence.identified import identified
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.state import State


def test_the_odds_of_a_rival_are_the_difference_of_scores() -> None:
    rng = np.random.default_rng(12)
    wrong, _ = lengths.planted(lengths.measurement(rng, 40), rng, "refraction-drift", 2.0)
    m = measurement_of(wrong.adjusted())
    bare = State.of(m)
    ranks = set()
    for number in range(len(m.families)):
        net = np.subtract(*bare.gains_of_family(number)[:2])
        state = bare.plus([m.effect(number, int(np.argmax(net)))])
        for rival in identified(state, state.fixed[0]).rivals:
            key = next(
                (i, j)
                for i, family in enumerate(m.families)
                for j, other in enumerate(family.alternatives)
                if other is rival.alternative
            )
            instead = bare.plus([m.effect(*key)])
            assert np.log(rival.odds) == pytest.approx(instead.score - state.score, abs=1e-6)
            ranks.add((state.fixed[0].rank, instead.fixed[0].rank))
    # prices differ by rank: an effect of two parameters stands beside one of one
    assert len({one == other for one, other in ranks}) == 2
