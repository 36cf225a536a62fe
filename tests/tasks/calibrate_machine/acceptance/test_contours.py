"""Circular and diagonal tests predicted from tables, against the textbook formulas of single errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import machine as sim

from metrocli.result import Result
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.acceptance.ranges import Profile, draws
from metrocli.tasks.calibrate_machine.settings import VolumeGrid

KNOTS = (5, 5, 5)
SPAN = sim.HIGH - sim.LOW
MIDDLE = (sim.HIGH + sim.LOW) / 2
PLANES = {"XY": (0, 1), "YZ": (1, 2), "ZX": (2, 0)}
SIGNS = {"PPP": (1, 1, 1), "NPP": (-1, 1, 1), "PNP": (1, -1, 1), "NNP": (-1, -1, 1)}


def calibrated(machine: sim.Machine, rng: np.random.Generator, noise: float, radius: float = 150.0) -> Result:
    job = replace(sim.settings(tools=sim.THREE, knots=KNOTS), volume=VolumeGrid((3, 3, 3), radius))
    points = sim.points(machine, rng, 150, sim.THREE, noise=noise)
    return calibrate_machine.run(calibrate_machine.TASK.job(job, points=points))


def round_trip(machine: sim.Machine, tool: np.ndarray, plane: str, radius: float) -> np.ndarray:  # type: ignore[type-arg]
    """Radial deviations about the least-squares circle of the points that the machine reaches."""
    a, b = PLANES[plane]
    turn = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    path = np.tile(MIDDLE, (360, 1))
    path[:, a] += radius * np.cos(turn)
    path[:, b] += radius * np.sin(turn)
    moved = path + np.array([machine.first_order(p, tool) for p in path])
    u, v = moved[:, a] - MIDDLE[a], moved[:, b] - MIDDLE[b]
    solved = np.linalg.lstsq(np.column_stack([2 * u, 2 * v, np.ones(360)]), u**2 + v**2, rcond=None)[0]
    return np.asarray(np.hypot(u - solved[0], v - solved[1]) - radius)


def test_squareness_alone() -> None:
    """A circle becomes an ellipse of G = c R; a diagonal changes by c Lx Ly / D (ISO 230-6), shorter or longer."""
    machine = sim.random_machine(np.random.default_rng(3), knots=KNOTS)
    c = 4e-5
    bare = replace(
        machine,
        tables={name: np.zeros_like(values) for name, values in machine.tables.items()},
        squareness=np.array([0.0, 0.0, c]),
    )
    result = calibrated(bare, np.random.default_rng(4), 0.0)
    found = result.tables["circular"]
    assert found.texts("plane") == ["XY", "YZ", "ZX"]
    assert found.numbers("G") == pytest.approx([c * 150, 0, 0], abs=1e-8)
    assert found.numbers("F_max") == pytest.approx([c * 75, 0, 0], abs=1e-8)
    assert found.numbers("F_min") == pytest.approx([-c * 75, 0, 0], abs=1e-8)
    figures = result.tables["diagonal_figures"]
    assert figures.texts("diagonal") == list(SIGNS)
    length = np.linalg.norm(SPAN)
    assert figures.numbers("length") == pytest.approx([length] * 4)
    profile = result.tables["diagonals"].numbers("deviation").reshape(4, -1)
    assert figures.numbers("E") == pytest.approx(np.ptp(profile, axis=1))
    ends = [-sx * sy * c * SPAN[0] * SPAN[1] / length for sx, sy, _ in SIGNS.values()]
    # the profile is that of a shear about machine zero: its end is the change of the diagonal's length
    start = np.array([np.where(np.array(one) > 0, sim.LOW, sim.HIGH) for one in SIGNS.values()])
    end = np.array([np.where(np.array(one) > 0, sim.HIGH, sim.LOW) for one in SIGNS.values()])
    shear = np.array([-c, 0, 0])
    exact = [np.linalg.norm(b + shear * b[1] - a - shear * a[1]) - length for a, b in zip(start, end, strict=True)]
    assert exact == pytest.approx(ends, abs=1e-6)
    assert profile[:, -1] == pytest.approx(ends, abs=1e-8)


def test_the_diagonals_of_a_worked_example() -> None:
    """Travels of 600, 520 and 500 mm, so diagonals of D = sqrt(880 400) = 938.296 mm (ISO 230-6), by hand.

    Axes 20 um/m too long, 10 too short and 15 too long, squareness a, b, c of 30, -20 and 40 urad: along a diagonal with
    the signs s the deviation grows evenly to `(sum k L^2 - c sx sy Lx Ly + b sx sz Lx Lz - a sy sz Ly Lz)/D`, where
    7.2 - 2.704 + 3.75 = 8.246 mm^2, c Lx Ly = 12.48, b Lx Lz = -6.0 and a Ly Lz = 7.8 mm^2. A screw with 12 um at x = 300
    and 0 at both ends adds `12 um x 600/D` in the middle, and nothing at the end.
    """
    machine = sim.random_machine(np.random.default_rng(3), knots=KNOTS)
    tables = {name: np.zeros_like(values) for name, values in machine.tables.items()}
    linear = {f"E{a}{a}": k * machine.positions(a) for a, k in (("X", 20e-6), ("Y", -10e-6), ("Z", 15e-6))}
    long = replace(machine, tables=tables | linear, squareness=(30e-6, -20e-6, 40e-6))
    result = calibrated(long, np.random.default_rng(4), 0.0)
    ends = np.array([-18.034, 18.926, 22.526, 9.566]) / 938.296
    assert result.tables["diagonals"].numbers("deviation").reshape(4, -1)[:, -1] == pytest.approx(ends, abs=2e-8)
    assert result.tables["diagonal_figures"].numbers("E") == pytest.approx(np.abs(ends), abs=2e-8)
    screw = replace(machine, tables=tables | {"EXX": np.array([0, 6e-3, 12e-3, 6e-3, 0])}, squareness=(0.0, 0.0, 0.0))
    result = calibrated(screw, np.random.default_rng(4), 0.0)
    profile = result.tables["diagonals"].numbers("deviation").reshape(4, -1)
    assert profile[:, 5] == pytest.approx(np.array([1, -1, 1, -1]) * 12e-3 * 600 / 938.296, abs=2e-8)
    assert profile[:, -1] == pytest.approx(0.0, abs=2e-8)
    assert result.tables["diagonal_figures"].numbers("E") == pytest.approx(12e-3 * 600 / 938.296, abs=2e-8)


def test_the_circle_of_any_machine() -> None:
    machine = sim.random_machine(np.random.default_rng(8), knots=KNOTS)
    result = calibrated(machine, np.random.default_rng(9), 0.0)
    tool = np.array(next(iter(sim.THREE.values())))
    for row, plane in enumerate(PLANES):
        left = round_trip(machine, tool, plane, 150.0)
        found = {name: float(result.tables["circular"].numbers(name)[row]) for name in ("G", "F_max", "F_min")}
        # the nominal radius and the first harmonic leave the second order, the square of the centre's shift over 2 R
        assert found["G"] == pytest.approx(np.ptp(left), abs=1e-4)
        assert found["F_max"] == pytest.approx(left.max(), abs=1e-4)


def test_a_circle_larger_than_its_plane_is_left_out() -> None:
    machine = sim.random_machine(np.random.default_rng(8), knots=KNOTS)
    result = calibrated(machine, np.random.default_rng(9), 0.0, radius=float(np.sort(SPAN)[1] / 2 - 1))
    assert len(result.tables["circular"]) == 1
    assert np.isfinite(result.tables["circular"].numbers("G")).all()


@pytest.mark.slow
def test_uncertainty_covers_the_truth() -> None:
    """6 calibrations of one machine: deviations of G and E from the truth in their standard uncertainties."""
    machine = sim.random_machine(np.random.default_rng(8), knots=KNOTS)
    rng = np.random.default_rng(10)
    true = calibrated(machine, rng, 0.0)
    scores = []
    for _ in range(6):
        result = calibrated(machine, rng, 1.0)
        for table, name in (("circular", "G"), ("diagonal_figures", "E")):
            off = result.tables[table].numbers(name) - true.tables[table].numbers(name)
            scores.append(off / (result.tables[table].numbers(f"U_{name}") / 2))
    squares = np.square(np.concatenate(scores))
    # seven figures that are partly correlated, 6 times: 99.9 % of chi-square with about 18 degrees of freedom
    assert 0.27 < squares.mean() < 2.37


def test_points_that_tie_for_an_extreme() -> None:
    """Of three equal points the largest has mean 0.846284 and variance 0.559467 (order statistics of the normal law)."""
    far = Profile(np.array([0.0, 0.0, 0.0, -50.0]), np.eye(4), draws(np.eye(4)))
    assert far.range_with_u() == (50.0, pytest.approx(2 * np.sqrt(0.846284**2 + 0.559467 + 1), rel=0.04))
    common = Profile(np.array([0.0, 0.0, 0.0, -50.0]), np.ones((4, 1)), draws(np.ones((1, 1))))
    assert common.range_with_u() == (50.0, pytest.approx(0.0, abs=1e-6))
    alone = Profile(np.array([0.0, -20.0, -50.0]), np.array([[3.0, 0.0], [5.0, 5.0], [-1.0, 0.0]]), draws(np.eye(2)))
    assert alone.range_with_u() == (50.0, pytest.approx(2 * 4, rel=0.04))


@pytest.mark.parametrize("size", [0.0, 0.5, 5.0])
def test_noise_does_not_pass_for_a_range(size: float) -> None:
    """The range of eight points ± U holds the truth, whether the true deviations are below the noise or above it."""
    rng, errors = np.random.default_rng(23), draws(np.eye(8))
    inside = []
    for _ in range(300):
        true = size * rng.normal(size=8)
        found, u = Profile(true + rng.normal(size=8), np.eye(8), errors).range_with_u()
        inside.append(abs(found - np.ptp(true)) < u)
    # 60 % at 0 and 85 % at 0.5, were the estimated deviations the centre of the draws
    assert np.mean(inside) > 0.88


def test_draws_do_not_depend_on_how_directions_of_equal_variance_round() -> None:
    """Two covariances that differ by rounding have the same draws, also where many directions have one variance."""
    rng = np.random.default_rng(17)
    turn = np.linalg.qr(rng.normal(size=(30, 30)))[0]
    covariance = (turn * np.repeat([4.0, 1.0, 0.0], 10)) @ turn.T
    rounding = 1e-15 * rng.normal(size=covariance.shape)
    first, second = draws(covariance), draws(covariance + rounding + rounding.T)
    assert np.abs(first - second).max() < 1e-6
    assert np.cov(first.T) == pytest.approx(covariance, abs=0.4)
