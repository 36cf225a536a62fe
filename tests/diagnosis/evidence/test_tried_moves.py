"""Which of the moves of a step are tried, and which state is chosen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from metrocli.diagnosis.evidence import moves, variances
from metrocli.diagnosis.evidence.search import forward
from metrocli.diagnosis.evidence.state import State
from tests.diagnosis.evidence.test_dense import NETWORK, measurement, number_of_effect, with_residual


@pytest.mark.parametrize("seed", range(3))
def test_correlated_errors_that_promise_too_much_hide_no_effect(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    m = measurement(NETWORK)
    family = number_of_effect(m, "refraction-drift")
    column = m.effect(family, 0).columns[:, 0]
    seen = column / np.linalg.norm(m.system.seen(column))
    noise = np.random.default_rng(seed).normal(size=m.system.rows)
    state = State.of(with_residual(m, noise + 12.0 * seen))

    def promising(state: State, quiet: set[int]) -> list[variances.Found]:
        return [
            replace(error, net=10 * error.net) for error in variances.correlated_errors(state, quiet) if error.net > 0
        ]

    monkeypatch.setattr(moves, "correlated_errors", promising)
    # one step: later ones may lose what entered, or keep it
    found = forward(state, 1)
    assert [m.alternative(part.key).effect.name for part in found.named] == ["refraction-drift"] and not found.random
