"""The share of a unit in the squares of projected white noise: its moments and its tails against drawn noise."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.diagnosis.noise import log_tail_of_share, moments_of_share


@pytest.mark.parametrize(("rows", "unknowns", "unit"), [(40, 12, 8), (60, 6, 30), (30, 15, 6)])
def test_tails_of_a_share_hold_in_drawn_noise(rows: int, unknowns: int, unit: int) -> None:
    rng = np.random.default_rng([31, rows])
    q, _ = np.linalg.qr(rng.normal(size=(rows, unknowns)))
    seen = np.eye(rows) - q @ q.T
    part = seen[:unit, :unit]
    noise = seen @ rng.normal(size=(rows, 20_000))
    shares = (noise[:unit] ** 2).sum(axis=0) / (noise**2).sum(axis=0)
    mean, variance = moments_of_share(rows - unknowns, float(np.trace(part)), float((part**2).sum()))
    assert mean == pytest.approx(shares.mean(), rel=0.01)
    assert variance == pytest.approx(shares.var(), rel=0.04)
    found = np.array([log_tail_of_share(share, mean, variance) for share in shares.tolist()])
    for level in (0.05, 0.01):
        beyond = float((found < np.log(level)).sum())
        # the beta distribution is no more than the right moments where parts are seen unequally: 15 % of the level
        assert abs(beyond - level * 20_000) < 4 * np.sqrt(level * 20_000) + 0.15 * level * 20_000
