"""Points of both faces of a tracker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated import machine as simulated

from metrocli.errors import InputError
from metrocli.instruments.tracker import FACE
from metrocli.tasks.calibrate_machine.methods.standstill import standstill


def test_the_face_of_a_point_is_a_condition_and_one_of_two() -> None:
    rng = np.random.default_rng(1)
    table = simulated.points(simulated.random_machine(rng), rng, 60, simulated.THREE, noise=0.0)
    faces = rng.choice([1.0, 2.0], len(table))
    settings = simulated.settings(tools=simulated.THREE, tool_uncertainty=0.001)
    problem = standstill(settings, replace(table, columns={**table.columns, "face": faces}))
    assert (problem.readings.observations.conditions[FACE] == 3 - 2 * faces).all()
    assert FACE not in standstill(settings, table).readings.observations.conditions
    with pytest.raises(InputError, match="the face is 1 or 2"):
        standstill(settings, replace(table, columns={**table.columns, "face": faces + 1}))
