"""Tracers that share an error of scale: what a network states, what it really is off by, and the warning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated.lengths import NOISE, Network, network, places, settings

from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.layout import distance
from metrocli.tasks.multilaterate.settings import LengthSimulation, Settings
from metrocli.tasks.shared.lengths import Scale

OWN, COMMON = 0.3e-6, 5e-6


def job(common: float | None, own: float = OWN) -> Settings:
    return replace(settings(own), scale=Scale(own, common))


def adjusted(net: Network, of: Settings, **more: Table) -> Result:
    return multilaterate.run(multilaterate.TASK.job(of, net.lengths(), net.point_table(), **more))


def relative(result: Result) -> float:
    """Stated standard uncertainty of the longest of some distances, relative to it."""
    found = max((distance(result, "P0", f"P{i}") for i in range(1, 20)), key=lambda one: one.value)
    return found.std / found.value


def size(points: np.ndarray) -> float:
    return float(np.linalg.norm(points - points.mean(axis=0)))


@pytest.mark.parametrize(
    ("tracers", "runs"), [(6, 20), *(pytest.param(one, 60, marks=pytest.mark.slow) for one in (4, 6, 8))]
)
def test_lengths_are_off_by_the_common_part_whatever_the_number_of_tracers(tracers: int, runs: int) -> None:
    """Monte Carlo by plain formulas: one draw for all tracers and one for each, then lengths and noise."""
    net, rng = network(20, tracers, seed=tracers), np.random.default_rng(tracers)
    errors = []
    for _ in range(runs):
        scale = 1 + rng.normal(0, OWN, tracers) + rng.normal(0, COMMON)
        result = adjusted(replace(net, scale=scale).read(rng), job(COMMON))
        errors.append(size(places(result.tables["points"])) / size(net.points) - 1)
    spread = float(np.sqrt(np.mean(np.square(errors))))
    expected = np.hypot(COMMON, OWN / np.sqrt(tracers))
    assert spread == pytest.approx(expected, rel=0.3)
    assert relative(result) == pytest.approx(expected, rel=0.03)
    # entered as independent scales the stated uncertainty falls with their number
    assert relative(adjusted(net, job(None, float(np.hypot(OWN, COMMON))))) < 0.65 * expected


def test_covariance_is_that_of_the_joint_prior() -> None:
    """Each scale has both parts; the mean of all has the common part and its share of the own ones."""
    result = adjusted(network(25, 5, seed=3), job(COMMON))
    rows = [i for i, e in enumerate(result.estimates) if e.name.endswith(".scale")]
    scales = result.covariance[np.ix_(rows, rows)]
    assert scales.mean() == pytest.approx(COMMON**2 + OWN**2 / 5, rel=0.02)
    assert 1 < np.sqrt(scales[0, 0]) / COMMON < np.hypot(1, OWN / COMMON) * 1.001


def test_a_vanishing_common_part_is_the_independent_case() -> None:
    net = network(25, 5, seed=4)
    tiny, none = adjusted(net, job(1e-12)), adjusted(net, job(0.0))
    assert tiny.statistics["dof"] == none.statistics["dof"]
    assert places(tiny.tables["points"]) == pytest.approx(places(none.tables["points"]), abs=1e-8)
    assert tiny.arrays["points_covariance"] == pytest.approx(none.arrays["points_covariance"], rel=1e-5, abs=1e-14)


def test_a_scale_better_than_its_source_is_warned_of() -> None:
    net = network(25, 4, seed=5)
    bar = {"from": np.array(["P0"]), "to": np.array(["P1"])}
    length = float(np.linalg.norm(net.points[0] - net.points[1]))
    bars = Table({**bar, "length": np.array([length]), "sigma": np.array([1e-4])}, {"length": "mm", "sigma": "mm"})

    def warned(of: Settings, **more: Table) -> list[str]:
        return [line for line in adjusted(net, of, **more).warnings if "count as independent" in line]

    (line,) = warned(job(None, 1e-6))
    assert line.startswith("the scale of the network has a standard uncertainty of 0.5 um/m, ")
    assert "because the scales of its 4 tracers, 1 um/m each, count as independent. " in line
    assert "write `scale: {uncertainty: OWN, common: 1 um/m}`" in line
    assert warned(job(0.0, 1e-6)) == warned(job(1e-6, 1e-7)) == warned(settings()) == []
    assert warned(job(None, 1e-6), distances=bars) == []


def test_simulate_draws_the_common_part_once() -> None:
    net = network(8, 6, seed=6)
    planned = replace(job(COMMON, 1e-9), noise=NOISE, simulation=LengthSimulation())
    found = []
    for seed in range(40):
        inputs = multilaterate.TASK.job(planned, Table({}), net.point_table(), net.tracer_table(0.0))
        truth = multilaterate.simulate(inputs, SimulationOptions(seed=seed)).truth
        found.append([truth[f"T{j}.scale"] - 1 for j in range(6)])
    scales = np.array(found)
    assert scales.std(axis=1).max() < 1e-8
    assert scales.mean(axis=1).std() == pytest.approx(COMMON, rel=0.4)
