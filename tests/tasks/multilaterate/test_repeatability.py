"""A mover that returns to its points for each tracer, not quite to the same places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import lengths as sim

from metrocli.result import Result
from metrocli.tasks.multilaterate import task as multilaterate

RETURN = 1e-3


def replayed(seed: int, n: int = 60, m: int = 6) -> tuple[sim.Network, sim.Network]:
    """A network, and the same with each tracer's readings taken at its own return to the points."""
    net = sim.network(n, m, seed)
    rng = np.random.default_rng(1000 + seed)
    at = net.points[:, None] + rng.normal(size=(n, m, 3)) * RETURN
    distance = np.linalg.norm(at - net.tracers, axis=2)
    sigma = np.sqrt(sim.NOISE.constant**2 + (sim.NOISE.proportional * distance) ** 2)
    return net, replace(net, readings=distance - net.dead + rng.normal(size=distance.shape) * sigma)


def run(net: sim.Network, repeatability: float | str | None, time: sim.Array | None = None) -> Result:
    settings = sim.settings()
    settings = replace(settings, noise=replace(settings.noise, repeatability=repeatability))
    table = net.lengths()
    if time is not None:
        table = replace(table, columns={**table.columns, "t": time}, units={**table.units, "t": "s"})
    return multilaterate.run(multilaterate.TASK.job(settings, table, net.point_table()))


def scores(result: Result, net: sim.Network) -> sim.Array:
    """Distances of points to the truth, over their standard deviation (of the coordinates, root mean square)."""
    found = result.tables["points"]
    off = sim.without_motion(found.stacked("xyz"), net.points) - net.points
    return off / found.stacked(("sx", "sy", "sz"))


def test_without_it_the_warning_names_the_setting_and_with_it_the_uncertainty_is_right() -> None:
    net, seen = replayed(1)
    blind, knowing = run(seen, None), run(seen, RETURN)
    assert blind.statistics["sigma0"] > 3
    assert any("repeatability: estimated" in warning for warning in blind.warnings)
    assert knowing.statistics["sigma0"] == pytest.approx(1, abs=0.15)
    assert np.sqrt((scores(blind, net) ** 2).mean()) > 3
    assert np.sqrt((scores(knowing, net) ** 2).mean()) == pytest.approx(1, abs=0.25)


def test_it_is_estimated_within_its_uncertainty() -> None:
    off = []
    for seed in range(4):
        _, seen = replayed(seed, 40)
        result = run(seen, "estimated")
        value, std = (result.statistics[name] for name in ("repeatability", "repeatability_std"))
        off.append((value - RETURN) / std)
        assert std < 0.1 * RETURN
        assert any("estimated from the lengths" in note for note in result.notes)
    assert np.abs(off).max() < 3.5


def test_tracers_that_read_at_once_see_one_place() -> None:
    """All lengths of a point at one time: the point is where the mover stood, and nothing changes."""
    net = sim.network(40, 5, 7)
    time = np.repeat(np.arange(40.0) * 5, 5)
    plain, knowing = run(net, None, time), run(net, RETURN, time)
    assert knowing.tables["points"].stacked("xyz") == pytest.approx(plain.tables["points"].stacked("xyz"), abs=1e-12)
    assert knowing.statistics["unknowns"] == plain.statistics["unknowns"]


def test_two_visits_by_all_tracers_share_a_deviation_each() -> None:
    """Two passes of four tracers: each of two stops of a point has one deviation, common to its lengths."""
    n, m = 30, 4
    first = sim.network(n, m, 9, noise=0.0)
    rng = np.random.default_rng(5)
    # eight names for the eight stations: each tracer stands elsewhere in the second pass
    tracers = np.concatenate([first.tracers, (sim.CORNERS[4:8] + 0.03) * sim.VOLUME])
    shift = rng.normal(size=(n, 2, 3)) * RETURN
    at = first.points[:, None] + np.repeat(shift, m, axis=1)
    distance = np.linalg.norm(at - tracers, axis=2)
    sigma = np.sqrt(sim.NOISE.constant**2 + (sim.NOISE.proportional * distance) ** 2)
    dead = np.concatenate([first.dead, first.dead])
    readings = distance - dead + rng.normal(size=distance.shape) * sigma
    net = replace(first, tracers=tracers, dead=dead, scale=np.ones(8), readings=readings)
    time = (np.arange(n)[:, None] * 5.0 + np.repeat([0.0, 9999.0], m)).ravel()
    result = run(net, RETURN, time)
    assert result.statistics["sigma0"] == pytest.approx(1, abs=0.2)
    assert np.sqrt((scores(result, net) ** 2).mean()) == pytest.approx(1, abs=0.3)
    alone = run(net, RETURN)
    assert result.statistics["unknowns"] == alone.statistics["unknowns"] + 3 * 2 * n
