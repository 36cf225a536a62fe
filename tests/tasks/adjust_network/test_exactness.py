"""Coordinates and covariances are those of a dense adjustment that shares nothing with the engine."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.network import network
from tasks.adjust_network.dense import Dense

from metrocli.formats import hdf5

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
