"""An effect near its price predicts with the probability that the other readings give it."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.diagnosis.evidence.folds import gains
from metrocli.diagnosis.evidence.gain import Held
from metrocli.diagnosis.evidence.identified import all_identified
from metrocli.diagnosis.evidence.state import State
from tests.diagnosis.evidence.test_dense import NETWORK, measurement, number_of_effect, with_residual


def test_a_mixture_has_the_mean_density_and_the_variance_of_both() -> None:
    one = np.ones(2)
    without, other = (
        Held(-3.0, np.array([2.0, 0.0]), one, one, one),
        Held(-1.0, np.array([0.0, 1.0]), one, one, 2 * one),
    )
    mixed = without.mixed(other, 0.25)
    assert np.exp(mixed.score) == pytest.approx(0.75 * np.exp(-3.0) + 0.25 * np.exp(-1.0))
    draws = np.random.default_rng(5).normal(size=(200_000, 2))
    chosen = np.random.default_rng(6).random((200_000, 1)) < 0.25
    seen = np.where(chosen, other.errors + np.sqrt(2) * draws, without.errors + draws)
    assert mixed.errors == pytest.approx(seen.mean(axis=0), abs=0.02)
    assert mixed.variances == pytest.approx(seen.var(axis=0), rel=0.02)
    assert without.mixed(other, 1.0) is other
    assert without.mixed(other, 0.0).score == pytest.approx(-3.0)


def test_what_the_evidence_names_just_so_is_confirmed() -> None:
    """The fold that shows an effect most is the one without which it is not chosen: its part must not be lost."""
    m, rng = measurement(NETWORK), np.random.default_rng(11)
    family = number_of_effect(m, "refraction-drift")
    column = m.effect(family, 0).columns[:, 0]
    seen = column / np.linalg.norm(m.system.seen(column))
    sums = []
    while len(sums) < 12:
        drawn = with_residual(m, rng.normal(size=m.system.rows) + 4.0 * seen)
        state = State.of(drawn, [drawn.effect(family, 0)])
        net = float(state.without_fixed()[0])
        if 0 < net < 2:
            sums.append(net + gains(state, all_identified(state))[0].log_score)
    assert np.mean(np.array(sums) > 0) > 0.8
