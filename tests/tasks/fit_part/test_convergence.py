"""Fits whose surfaces bend far away below a step, at and near the largest least overstock."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated.castings import casting
from tasks.fit_part.test_fit import dense, even, moved
from tasks.fit_part.test_uncertainty import ideal_of

from metrocli.geometry import poses
from metrocli.tasks.fit_part.fit import max_least_overstock
from metrocli.tasks.fit_part.solve import fitted_part
from metrocli.tasks.fit_part.stock import Stock


@pytest.mark.alike
@pytest.mark.parametrize(
    ("seed", "each", "aim", "below"),
    [
        (39, 14, "most", 0.0),
        (70, 6, "most", 0.0),
        (210, 6, "even", 0.001),
        (210, 6, "least-motion", 0.001),
        (255, 14, "least-motion", 1.0),
        (286, 6, "most", 0.0),
    ],
)
def test_a_rough_casting_whose_bores_bend_away_below_a_step(
    seed: int, each: int, aim: str, below: float, tmp_path: Path
) -> None:
    """With 5 to 40 mm of overstock a step on a bore or boss misses the minimum by far more than it gains."""
    one, part = casting(seed, each=each, stock=(5, 40), rough=2.0), ideal_of(tmp_path)
    stock = Stock(part, one.points, np.array([part.names.index(name) for name in one.surface]))
    top = max_least_overstock(stock, poses.inverse(poses.pose_from_euler(one.pose[:3], one.pose[3:])))
    fit = fitted_part(stock, aim, top[1] - below, top, np.zeros(6))[1]
    back = poses.inverse(fit.to_part)
    pose = np.concatenate([back[:3], poses.euler_form(back)[3:]])
    assert one.overstock_at(pose).min() >= top[1] - below - 1e-7
    assert fit.optimality < 1e-4 and fit.iterations < 15
    if aim != "most":
        value = even(one) if aim == "even" else moved(one)
        assert value(pose) <= value(dense(one, pose, value, top[1] - below)) * (1 + 1e-6)
