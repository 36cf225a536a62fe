"""Figures of ISO 230-2 and their uncertainty: a worked example, and against formulas and Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.tasks.calibrate_machine.acceptance.positioning import FIGURES, LineUncertainty, expanded, figures

UP = np.array([[0.0, 4.0, 1.0], [2.0, 5.0, 1.0], [1.0, 6.0, 4.0]]) / 1000
DOWN = np.array([[3.0, 9.0, 2.0], [5.0, 9.0, 5.0], [4.0, 9.0, 5.0]]) / 1000
TARGETS = np.array([0.0, 100.0, 300.0])


def test_a_worked_example() -> None:
    """Three targets, three runs each way, with pencil and paper [um].

    up: means 1, 5, 2, s = 1, 1, sqrt 3; down: means 4, 9, 4, s = 1, 0, sqrt 3; B_i = -3, -4, -2.
    """
    found = {name: 1000 * value for name, value in figures(UP, DOWN).items()}
    root = np.sqrt(3)
    assert found["B"] == pytest.approx(4) and found["B_mean"] == pytest.approx(-3)
    assert found["M"] == pytest.approx(7.0 - 2.5)
    assert found["E"] == pytest.approx(9 - 1)
    assert found["E_up"] == pytest.approx(5 - 1) and found["E_down"] == pytest.approx(9 - 4)
    assert found["R_up"] == pytest.approx(4 * root) and found["R_down"] == pytest.approx(4 * root)
    # 2 s_up + 2 s_down + |B_i|: 7, 6, 2 + 4 sqrt 3
    assert found["R"] == pytest.approx(2 + 4 * root)
    # x + 2 s up: 3, 7, 2 + 2 sqrt 3; x - 2 s up: -1, 3, 2 - 2 sqrt 3
    assert found["A_up"] == pytest.approx(7 - (2 - 2 * root))
    # down: 6, 9, 4 + 2 sqrt 3 and 2, 9, 4 - 2 sqrt 3
    assert found["A_down"] == pytest.approx(9 - (4 - 2 * root))
    assert found["A"] == pytest.approx(9 - (2 - 2 * root))


def test_uncertainty_of_the_worked_example() -> None:
    """By hand: variances of means u²/3, of standard deviations u²/2, and the lever of the scale."""
    u, scale = 0.0002, 1e-6
    found = expanded(UP, DOWN, TARGETS, LineUncertainty(u, scale))
    assert found["B"] == pytest.approx(2 * u * np.sqrt(2 / 3))
    assert found["B_mean"] == pytest.approx(2 * u * np.sqrt(2 / 9))
    # the extremes are at 100 mm (down) and 0 mm (up)
    assert found["E"] == pytest.approx(2 * np.hypot(u * np.sqrt(2 / 3), 100 * scale))
    assert found["M"] == pytest.approx(2 * np.hypot(u * np.sqrt(1 / 3), 100 * scale))
    assert found["R_up"] == pytest.approx(2 * 4 * u / np.sqrt(2))
    assert found["R"] == pytest.approx(2 * u * np.sqrt(2 / 3 + 4 / 2 + 4 / 2))
    # x - 2 s at 300 mm, x + 2 s at 100 mm
    assert found["A_up"] == pytest.approx(2 * np.hypot(u * np.sqrt(2 / 3 + 2 * 4 / 2), 200 * scale))


def test_uncertainty_is_what_the_figures_scatter_by() -> None:
    """600 simulated tests of five runs each way at twelve targets, with extremes that stand out."""
    rng = np.random.default_rng(2)
    targets = np.linspace(0, 550, 12)
    shape = 0.02 * np.sin(targets / 90)
    spread = np.where(np.arange(12) == 5, 0.004, 0.001)
    up = shape + spread * rng.normal(size=(5, 12))
    down = shape - np.where(np.arange(12) == 3, 0.012, 0.003) + spread * rng.normal(size=(5, 12))
    u, scale = 1e-5, 3e-7
    stated = expanded(up, down, targets, LineUncertainty(u, scale))
    drawn = []
    for _ in range(600):
        factor = scale * rng.normal() * targets
        noise = u * rng.normal(size=(2, 5, 12))
        drawn.append(list(figures(up + factor + noise[0], down + factor + noise[1]).values()))
    scatter = 2 * np.std(drawn, axis=0, ddof=1)
    assert dict(zip(FIGURES, scatter, strict=True)) == pytest.approx(stated, rel=0.12)


def test_one_run_has_no_repeatability() -> None:
    found, spread = figures(UP[:1], DOWN), expanded(UP[:1], DOWN, TARGETS, LineUncertainty(1e-4))
    for name in ("A", "A_up", "R", "R_up"):
        assert np.isnan(found[name]) and np.isnan(spread[name])
    for name in ("A_down", "R_down", "B", "E", "M"):
        assert np.isfinite(found[name]) and spread[name] > 0
