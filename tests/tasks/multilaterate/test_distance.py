"""`show --distance`: the distance of two points with the uncertainty of the pair."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated.lengths import CORNERS, Network, network, settings

from metrocli.errors import InputError, UsageError
from metrocli.formats import hdf5
from metrocli.instruments import tracer
from metrocli.record import Record
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.layout import distance
from metrocli.tasks.multilaterate.problem import build
from metrocli.tasks.multilaterate.settings import Files
from metrocli.tasks.multilaterate.solve import solve


def bars() -> Table:
    """Two calibrated distances: points are then unknowns that are not eliminated."""
    names = {"from": np.array(["P0", "P2"]), "to": np.array(["P1", "P3"])}
    return Table(
        names | {"length": np.array([300.0, 400.0]), "sigma": np.array([1.0, 1.0])}, {"length": "mm", "sigma": "mm"}
    )


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("scale", [None, 5e-7])
def test_its_uncertainty_is_that_of_the_full_covariance(known: bool, scale: float | None) -> None:
    net = network(20, 5, seed=1)
    distances = bars() if known else None
    result = multilaterate.run(
        multilaterate.TASK.job(settings(scale), net.lengths(), net.point_table(), distances=distances)
    )
    solved = solve(build(settings(scale), Files(net.lengths(), net.point_table(), distances=distances)), remove=False)
    full = solved.solution.covariance_or_raise().of(tracer.POINT)
    points = solved.solution.blocks[tracer.POINT].values
    for a, b in ((0, 1), (3, 17), (19, 4)):
        found = distance(result, f"P{a}", f"P{b}")
        e = np.zeros(60)
        e[3 * a : 3 * a + 3] = (points[a] - points[b]) / np.linalg.norm(points[a] - points[b])
        e[3 * b : 3 * b + 3] = -e[3 * a : 3 * a + 3]
        assert found.value == pytest.approx(np.linalg.norm(points[a] - points[b]), abs=1e-9)
        assert found.std == pytest.approx(np.sqrt(e @ full @ e), rel=1e-6)


@pytest.mark.slow
def test_it_covers_the_truth() -> None:
    rng = np.random.default_rng(3)
    net = network(25, 4, seed=4)
    inside = []
    for _ in range(40):
        drawn = net.read(rng)
        result = multilaterate.run(
            multilaterate.TASK.job(settings(), drawn.lengths(), drawn.point_table(), drawn.tracer_table())
        )
        for a, b in ((0, 1), (2, 9), (5, 20), (11, 24)):
            found = distance(result, f"P{a}", f"P{b}")
            inside.append(abs(found.value - np.linalg.norm(net.points[a] - net.points[b])) <= 1.96 * found.std)
    assert 0.9 <= np.mean(inside) <= 0.99


def test_distances_along_lines_have_the_uncertainty_of_the_paper() -> None:
    """Härtig et al. figure 7: 0.1 um to 0.2 um (k = 1) with four tracers, on lines through a fifth as reference.

    The volume, of 0.7 m x 0.5 m x 0.4 m, holds a grid and two inclined lines of 0.5 m; the paper gives no layout.
    """
    size = np.array([700.0, 500.0, 400.0])
    rng = np.random.default_rng(1)
    tracers = CORNERS[[0, 1, 2, 3, 6]] * size
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 4)] * 3), axis=-1).reshape(-1, 3) * size
    aims = np.array([[0.6, 0.55, 0.4], [0.45, 0.6, 0.6]]) * size
    lines = []
    for aim in aims:
        direction = (aim - tracers[4]) / np.linalg.norm(aim - tracers[4])
        lines.append(aim + np.linspace(-250, 250, 6)[:, None] * direction)
    points = np.concatenate([*lines, grid])
    nominal = points + rng.normal(0, 0.02, points.shape)
    net = Network(points, nominal, tracers, rng.uniform(100, 400, 5), np.ones(5), np.zeros((len(points), 5))).read(rng)
    four = replace(net, tracers=tracers[:4], dead=net.dead[:4], scale=net.scale[:4], readings=net.readings[:, :4])
    result = multilaterate.run(multilaterate.TASK.job(settings(), four.lengths(), four.point_table()))
    for first in (0, 6):
        found = [distance(result, f"P{first}", f"P{first + i}") for i in range(1, 6)]
        assert all(0.1e-3 <= one.std <= 0.2e-3 for one in found), [one.std for one in found]
        # the fifth, on the line, reads the same distances directly
        direct = np.abs(net.readings[first + 1 : first + 6, 4] - net.readings[first, 4])
        assert all(
            abs(one.value - true) < 4 * np.hypot(one.std, 0.2e-3) for one, true in zip(found, direct, strict=True)
        )


def test_on_the_command_line(tmp_path: Path, metrocli) -> None:  # type: ignore[no-untyped-def]
    net = network(20, 4, seed=2)
    result = multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table()))
    hdf5.write(tmp_path / "o.h5", result, Record("", (), "", ""))
    expected = distance(result, "P3", "P8")
    ran = metrocli("show", tmp_path / "o.h5", "--distance", "P3", "P8", "--json")
    assert ran.code == 0
    listed_at = json.loads(ran.out)
    assert listed_at["value"] == pytest.approx(expected.value, abs=1e-12) and listed_at["std"] == pytest.approx(
        expected.std, rel=1e-9
    )
    assert "P3 - P8" in metrocli("show", tmp_path / "o.h5", "--distance", "P3", "P8").out
    ran = metrocli("show", tmp_path / "o.h5", "--distance", "P3", "P88")
    assert ran.code == 2 and "no point 'P88'" in ran.err and "allowed: P0" in ran.err
    assert metrocli("show", tmp_path / "o.h5", "--distance", "P3", "P3").code == 2


def test_results_without_it_are_refused_in_words() -> None:
    with pytest.raises(InputError, match="does not hold the covariance between points"):
        distance(Result("x", "", (), np.zeros((0, 0)), {}), "a", "b")
    with pytest.raises(UsageError):
        net = network(20, 4, seed=2)
        distance(multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table())), "P1", "Q")
