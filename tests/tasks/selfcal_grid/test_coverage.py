"""Uncertainties that hold: intervals cover what they say, and the noise gain is 0.64 whatever the size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtrc
from simulated.grid import NOISE, PITCH, grid, without

from metrocli.adjust.coupled_fields import adjust_fields, design_of
from metrocli.instruments import ball_grid as bg
from metrocli.table import Table
from metrocli.tasks.selfcal_grid import readings as grid_readings
from metrocli.tasks.selfcal_grid import task as selfcal_grid
from metrocli.tasks.selfcal_grid.problem import GridProblem, build
from metrocli.tasks.selfcal_grid.sequence import noise_gains
from metrocli.tasks.selfcal_grid.settings import views_of

RUNS = 100


def problem(n: int, views: str = "1234", seed: int = 0, drop: float = 0.0) -> tuple[GridProblem, object]:
    one = grid(n, views, seed)
    settings = one.settings()
    table = one.read(np.random.default_rng(0), noise=0.0)
    table = without(table, np.random.default_rng(seed).random(len(table)) < drop)
    readings = grid_readings.read(views_of(settings), settings.grid.half, table)
    return build(readings, (settings.grid.half, PITCH), settings.noise), one


@pytest.mark.slow
@pytest.mark.parametrize(("views", "drop"), [("1234", 0.0), pytest.param("123456", 0.15, marks=pytest.mark.slow)])
def test_intervals_cover_what_they_say(views: str, drop: float) -> None:
    """95 % intervals of the machine error over 100 measurements of one machine, and the global test."""
    made, one = problem(5, views, seed=3, drop=drop)
    design = design_of(made.fields)
    std = design.std(bg.MACHINE)
    rng = np.random.default_rng(7)
    inside, p_values = [], []
    group = made.readings
    for _ in range(RUNS):
        noisy = group.observations.readings + rng.normal(0, NOISE, group.observations.readings.shape)
        fields = replace(made.fields, groups=(group.with_observations(group.observations.with_readings(noisy)),))
        solution = adjust_fields(fields, design).solution
        error = solution.blocks[bg.MACHINE].values - one.machine
        inside.append(np.abs(error) <= 1.96 * std)
        p_values.append(float(chdtrc(solution.dof, solution.cost)))
    assert 0.93 < np.mean(inside) < 0.97
    assert 0.02 < np.mean(np.array(p_values) < 0.1) < 0.2


def test_an_estimated_noise_is_that_of_the_readings_and_not_of_calibrated_lengths() -> None:
    """A machine that reads to 0.1 um, and twelve lengths known to 0.5 um."""
    one, rng, found = grid(3, "1234", 2), np.random.default_rng(5), list[float]()
    ends = np.array([rng.choice(27, 2, replace=False) for _ in range(12)])
    balls = PITCH * one.balls + one.artefact
    exact = np.linalg.norm(balls[ends[:, 0]] - balls[ends[:, 1]], axis=1)
    names = [f"{axis}{end}" for end in (1, 2) for axis in "ijk"]
    columns = dict(zip(names, np.concatenate([one.balls[ends[:, 0]], one.balls[ends[:, 1]]], axis=1).T, strict=True))
    for _ in range(4):
        length = exact + rng.normal(0, 5e-4, 12)
        lengths = Table({**columns, "length": length, "sigma": np.full(12, 5e-4)}, {"length": "mm", "sigma": "mm"})
        settings = replace(one.settings(), noise="estimated")
        result = selfcal_grid.run(selfcal_grid.TASK.job(settings, one.read(rng, 1e-4), lengths))
        noise = result.statistics["noise"]
        assert isinstance(noise, dict)
        found.append(noise["mm"])
    assert 0.9 < np.sqrt(np.mean(np.square(found))) / 1e-4 < 1.1


@pytest.mark.alike
@pytest.mark.parametrize("n", [3, 5, 7, 9, 11])
def test_the_noise_gain_does_not_depend_on_the_size(n: int) -> None:
    made, _ = problem(n)
    std = design_of(made.fields).std(bg.MACHINE)
    assert np.sqrt((std**2).mean()) / NOISE == pytest.approx(0.64, abs=0.02)


def test_the_sequence_of_the_paper_loses_something() -> None:
    """Views fitted first and differences against view 1 are unbiased, but not least squares."""
    made, _ = problem(5)
    joint, sequence = noise_gains(made, np.random.default_rng(1), 60)
    assert joint == pytest.approx(0.64, abs=0.02)
    assert 1.1 < sequence / joint < 1.3


def test_estimated_noise_scales_the_uncertainties() -> None:
    from metrocli.tasks.selfcal_grid import task as selfcal_grid

    one = grid(5, seed=12)
    table = one.read(np.random.default_rng(4), noise=3 * NOISE)
    declared = selfcal_grid.run(selfcal_grid.TASK.job(one.settings(3 * NOISE, leave_one_out="no"), table))
    found = selfcal_grid.run(selfcal_grid.TASK.job(replace(one.settings(leave_one_out="no"), noise="estimated"), table))
    ratio = found.tables["machine_error"].numbers("s_ex") / declared.tables["machine_error"].numbers("s_ex")
    assert np.allclose(ratio, declared.statistics["sigma0"], rtol=1e-6)
    assert found.statistics["noise"]["mm"] == pytest.approx(3 * NOISE, rel=0.1)
    assert found.statistics["noise_estimated"] is True
    assert "p_value" not in found.statistics
    assert np.allclose(
        found.tables["machine_error"].numbers("ex"), declared.tables["machine_error"].numbers("ex"), atol=1e-9
    )
