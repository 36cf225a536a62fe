"""Coordinates and covariances are those of a dense adjustment that shares nothing with the engine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.network import NOISE, network, sigmas
from tasks.adjust_network.dense import Dense

from metrocli.formats import hdf5
from metrocli.geometry import poses
from metrocli.uncertainty.predicted import after_fit, points_of

Metrocli = Callable[..., Any]
MAKES: dict[str, dict[str, Any]] = {
    "trackers": {"faces": 2},
    "one on its side": {"rolled": True},
    "levelled": {"levelled": True},
    "one station": {"stations": 1, "faces": 2},
    "mixed": {"mixed": True},
}


@pytest.mark.alike
@pytest.mark.parametrize("make", MAKES)
def test_points_and_covariance_are_those_of_the_dense_adjustment(make: str, tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(11), **MAKES[make])
    ran = metrocli("adjust-network", net.write(tmp_path))
    assert ran.code == 0, ran.err
    result = hdf5.read(tmp_path / "result.h5")[0]
    x, q, squares = Dense(net).solve()
    assert np.abs(result.tables["points"].stacked("xyz") - x).max() < 1e-7
    joint = result.arrays["points_joint_covariance"]
    assert np.abs(joint - q).max() < 1e-6 * np.diag(q).max()
    assert np.abs(np.diag(joint) / np.diag(q) - 1).max() < 1e-6
    assert result.statistics["chi2"] == pytest.approx(squares, rel=1e-6)


@pytest.mark.parametrize("levelled", [False, True])
def test_stations_on_the_points_of_a_free_network_give_what_all_give_together(
    levelled: bool, tmp_path: Path, metrocli: Metrocli
) -> None:
    """The covariance of a free network is singular, and its points are no independent readings of their places."""
    job = network(np.random.default_rng(15), stations=4, faces=2, levelled=levelled).write(tmp_path)
    text, found = job.read_text(), {}
    files = {name: (tmp_path / f"{name}.csv").read_text().splitlines() for name in ("readings", "stations")}
    for name, chosen, points in (
        ("all", "1234", "points.csv"),
        ("first", "12", "points.csv"),
        ("more", "34", "first.h5"),
    ):
        for file, (head, *rows) in files.items():
            kept = [row for row in rows if row[1] in chosen]
            (tmp_path / f"{file}.csv").write_text("\n".join([head, *kept, ""]))
        job.write_text(text.replace("points.csv", points).replace("result.h5", f"{name}.h5"))
        ran = metrocli("adjust-network", job)
        assert ran.code == 0, ran.err
        found[name] = points_of(hdf5.read(tmp_path / f"{name}.h5")[0])
    together, after = found["all"], found["more"]
    stated = [np.sqrt(np.diagonal(after_fit(one, one.own), axis1=1, axis2=2)) for one in (together, after)]
    assert stated[1] == pytest.approx(stated[0], rel=1e-4)
    laid = poses.apply(poses.fit_pose(after.values, together.values), after.values)
    assert np.abs((laid - together.values) / stated[0]).max() < 1e-3


def test_without_a_list_the_first_station_is_the_frame(tmp_path: Path, metrocli: Metrocli) -> None:
    net = network(np.random.default_rng(12), listed=False)
    ran = metrocli("adjust-network", net.write(tmp_path))
    assert ran.code == 0, ran.err
    result = hdf5.read(tmp_path / "result.h5")[0]
    stations, found = result.tables["stations"], result.tables["points"].stacked("xyz")
    first = [stations.numbers(name)[0] for name in ("x", "y", "z", "alpha", "beta", "gamma")]
    assert np.abs(first).max() < 1e-9
    order = [net.names.index(name) for name in result.tables["points"].texts("point")]
    true = (net.points - net.places[0]) @ net.rotations[0]
    assert np.abs(found - true[order]).max() < 0.1
    between = np.linalg.norm(found[:, None] - found, axis=2)
    exact = np.linalg.norm(net.points[order][:, None] - net.points[order], axis=2)
    assert np.abs(between - exact).max() < 0.05


def test_an_estimated_noise_leaves_bars_and_given_points_as_they_are_stated(tmp_path: Path, metrocli: Metrocli) -> None:
    """The result is that of instruments that declare as many times the noise; a bar has its certificate."""
    net, rng = network(np.random.default_rng(13), stations=3), np.random.default_rng(14)
    given = (0, 1, 2, 3)
    near = net.near.copy()
    near[list(given)] = net.points[list(given)] + rng.normal(0, 0.01, (4, 3))
    bars = tuple((a, b, float(np.linalg.norm(net.points[a] - net.points[b]))) for a, b in ((4, 5), (6, 7)))
    net = replace(net, near=near, given=given, bars=bars).with_effect(
        2.8 * rng.normal(size=net.seen.shape) * sigmas(net.seen)
    )
    results = []
    job = net.write(tmp_path, "noise: estimated\n")
    assert metrocli("adjust-network", job).code == 0
    results.append(hdf5.read(tmp_path / "result.h5")[0])
    f = results[0].statistics["noise_factor"]
    assert 2 < f < 4
    larger = (
        f"{{azimuth: {2 * f} urad, elevation: {2 * f} urad, lateral: {4 * f} um, "
        f"distance: {{constant: {2 * f} um, proportional: {0.3 * f} um/m}}}}"
    )
    net.write(tmp_path)
    job.write_text(job.read_text().replace(NOISE, larger))
    assert metrocli("adjust-network", job, "--force").code == 0
    results.append(hdf5.read(tmp_path / "result.h5")[0])
    places, joint = zip(
        *((one.tables["points"].stacked("xyz"), one.arrays["points_joint_covariance"]) for one in results), strict=True
    )
    assert np.abs(places[0] - places[1]).max() < 1e-6
    assert np.abs(np.diag(joint[0]) / np.diag(joint[1]) - 1).max() < 1e-6
