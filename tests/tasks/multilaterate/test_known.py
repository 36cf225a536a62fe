"""Absolute distances, known points and lengths, and one tracer at many stations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated.lengths import network, places, settings, without_motion

from metrocli.errors import InputError, UndeterminedError
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate


def test_absolute_distances_have_no_dead_path() -> None:
    """Four tracers of unknown place are enough for positions, as long as the points are many."""
    net = replace(network(30, 4, seed=1), dead=np.zeros(4)).read(np.random.default_rng(0))
    result = multilaterate.run(multilaterate.TASK.job(settings(measures="absolute"), net.lengths(), net.point_table()))
    assert not any("dead_path" in e.name for e in result.estimates)
    assert result.statistics["unknowns"] == 3 * 30 + 3 * 4
    error = without_motion(places(result.tables["points"]), net.points) - net.points
    stated = result.tables["points"].stacked(["sx", "sy", "sz"])
    assert 0.5 < np.sqrt((error**2).mean() / (stated**2).mean()) < 1.6


def test_an_absolute_distance_below_zero_is_refused_with_its_line() -> None:
    net = network(10, 4)
    lengths = replace(net, readings=np.where(net.readings > 0, net.readings, 100.0)).lengths()
    lengths.columns["length"][17] = -3.0
    with pytest.raises(InputError, match=r"lengths.csv:19: error: an absolute distance is not above zero"):
        multilaterate.run(multilaterate.TASK.job(settings(measures="absolute"), lengths, net.point_table()))


def test_known_points_fix_the_frame_and_the_scale() -> None:
    """Six points known to 1 um, three of them exactly: the truth itself is found, in its frame."""
    net = network(30, 5, seed=2, scale=3e-6)
    sigma = np.full(30, np.nan)
    sigma[:3], sigma[3:6] = 0.0, 1e-3
    nominal = net.nominal.copy()
    nominal[:3] = net.points[:3]
    nominal[3:6] = net.points[3:6] + np.random.default_rng(3).normal(0, 1e-3, (3, 3))
    net = replace(net, nominal=nominal)
    result = multilaterate.run(
        multilaterate.TASK.job(settings(1e-5, datum="points"), net.lengths(), net.point_table(sigma=sigma))
    )
    assert result.statistics["conditions"] == 0
    error = places(result.tables["points"]) - net.points
    stated = result.tables["points"].stacked(["sx", "sy", "sz"])
    assert np.abs(error[:3]).max() == 0
    assert np.abs(error[3:]).max() < 4.5 * stated[3:].max()
    assert (np.abs(error[3:]) <= 1.96 * stated[3:]).mean() > 0.9
    scales = [e for e in result.estimates if e.name.endswith(".scale")]
    assert all(abs(e.value - s) < 4 * e.std and e.std < 2e-6 for e, s in zip(scales, net.scale, strict=True))


def test_a_known_length_controls_the_common_scale() -> None:
    """All tracers read 5 um/m long: only the calibrated distance can tell, and does."""
    net = replace(network(30, 4, seed=4), scale=np.full(4, 1 + 5e-6)).read(np.random.default_rng(4))
    truth = float(np.linalg.norm(net.points[0] - net.points[1]))
    bar = Table(
        {"from": np.array(["P0"]), "to": np.array(["P1"]), "length": np.array([truth]), "sigma": np.array([1e-5])},
        {"length": "mm", "sigma": "mm"},
    )
    free = multilaterate.run(multilaterate.TASK.job(settings(1e-5), net.lengths(), net.point_table()))
    with_bar = multilaterate.run(
        multilaterate.TASK.job(settings(1e-5), net.lengths(), net.point_table(), distances=bar)
    )

    def scale(result: object) -> tuple[float, float]:
        of = [e for e in result.estimates if e.name.endswith(".scale")]  # type: ignore[attr-defined]
        return float(np.mean([e.value for e in of])) - 1, of[0].std

    assert abs(scale(free)[0]) < 1e-7
    assert scale(free)[1] > 4e-6
    assert scale(with_bar)[0] == pytest.approx(5e-6, abs=4 * scale(with_bar)[1])
    assert scale(with_bar)[1] < 1e-6


def test_points_that_are_said_to_be_known_and_are_not() -> None:
    net = network(30, 4)
    with pytest.raises(UndeterminedError):
        multilaterate.run(multilaterate.TASK.job(settings(datum="points"), net.lengths(), net.point_table()))


def test_tracers_of_known_place() -> None:
    """With places and dead paths to spare, three lengths a point are enough."""
    net = network(20, 3, seed=5)
    tracers = Table(
        {"tracer": np.array(net.stations), **dict(zip("xyz", net.tracers.T, strict=True)), "sigma": np.zeros(3)},
        dict.fromkeys(("x", "y", "z", "sigma"), "mm"),
    )
    absolute = replace(net, dead=np.zeros(3)).read(np.random.default_rng(2))
    result = multilaterate.run(
        multilaterate.TASK.job(settings(measures="absolute"), absolute.lengths(), absolute.point_table(), tracers)
    )
    assert result.statistics["dof"] == 0
    error = places(result.tables["points"]) - net.points
    assert np.abs(error).max() < 5 * result.tables["points"].stacked(["sx", "sy", "sz"]).max()


@pytest.mark.parametrize("stations", [4, 7])
def test_one_tracer_at_many_stations(stations: int) -> None:
    """Sequential: each station is a tracer of its own name, and not every station sees every point."""
    net = network(60, 8, seed=6)
    net = replace(
        net,
        tracers=net.tracers[:stations],
        dead=net.dead[:stations],
        scale=net.scale[:stations],
        readings=net.readings[:, :stations].copy(),
    )
    if stations > 4:
        net.readings[:20, 5] = net.readings[40:, 6] = np.nan
    result = multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table()))
    error = without_motion(places(result.tables["points"]), net.points) - net.points
    stated = result.tables["points"].stacked(["sx", "sy", "sz"])
    assert 0.5 < np.sqrt((error**2).mean() / (stated**2).mean()) < 1.6
    assert len(result.tables["residuals"]) == np.isfinite(net.readings).sum()


def test_points_and_tracers_without_a_length_are_left_out_and_named() -> None:
    net = network(30, 5, seed=7)
    net.readings[4] = np.nan
    net.readings[:, 2] = np.nan
    result = multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table(), net.tracer_table()))
    assert any("P4" in line for line in result.warnings)
    assert any("T2" in line for line in result.warnings)
    assert "P4" not in result.tables["points"].texts("point")
    assert "T2" not in result.tables["tracers"].texts("tracer")
