"""A plane path does not tell on which side of it a station stands."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import machine as sim
from simulated import machine_lengths as lengths

from metrocli.errors import UndeterminedError
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine

STATIONS = lengths.STATIONS[:4] * [1, 1, 0] + [[0, 0, -200], [0, 0, -150], [0, 0, -420], [0, 0, 330]]


def run(listed: Table | None) -> Table:
    rng = np.random.default_rng(5)
    position = np.column_stack([rng.uniform(sim.LOW[:2], sim.HIGH[:2], (120, 2)), np.full(120, -100.0)])
    i, j = np.indices((120, 4)).reshape(2, -1)
    length = np.linalg.norm(position[i] + [0, 0, 120] - STATIONS[j], axis=1) - 300 + rng.normal(0, 1e-3, 480)
    columns = {"point": np.array([f"P{k}" for k in i]), "station": np.array([f"S{k + 1}" for k in j])}
    columns |= dict(zip("xyz", position[i].T, strict=True)) | {"length": length}
    table = Table(columns, dict.fromkeys(("x", "y", "z", "length"), "mm"), "lengths.csv")
    settings = lengths.settings(sim.ONE, estimate=("EXX", "EYY", "C0Y"))
    result = calibrate_machine.run(calibrate_machine.TASK.job(settings, lengths=table, stations=listed))
    return result.tables["not_controlled"]


def test_stations_without_a_list_are_refused() -> None:
    with pytest.raises(UndeterminedError, match=r"two places fit the lengths alike(.|\n)*station S1 at"):
        run(None)


def test_a_list_decides_and_the_result_says_so() -> None:
    hidden = run(lengths.listed(STATIONS + np.random.default_rng(1).normal(0, 20, STATIONS.shape)))
    assert "mirror image of station S1" in hidden.texts("effect")[0]
