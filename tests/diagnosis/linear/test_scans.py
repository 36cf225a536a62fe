"""Values of scanned numbers that are tried."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from metrocli.arrays import Array
from metrocli.diagnosis.linear.scans import most_tried, scans
from metrocli.effects.effect import Effect, Parameter, change_points

ROWS, PARAMETERS = 2560, 6
GRID: Array = np.linspace(15.0, 34.0, 31)
HELD = 20_000_000
"""Elements of the columns of a scan"""


def effect(scanned: int) -> Effect:
    """Return an effect with six sizes, and some wavelengths of 31 values each."""
    sizes = tuple(Parameter(f"a{i}") for i in range(PARAMETERS))
    waves = tuple(Parameter(f"s{i}", grid=lambda conditions: GRID, tried=len(GRID)) for i in range(scanned))
    return Effect("waves", "", sizes, scanned=waves)


@pytest.mark.parametrize("scanned", [1, 2, 3, 4])
def test_all_combinations_of_several_scanned_numbers_fit_in_memory(scanned: int) -> None:
    """A law with three wavelengths of 31 values has 29,791 combinations, whose columns would take 3.7 GB."""
    model = SimpleNamespace(readings=[SimpleNamespace(observations=SimpleNamespace(conditions={}))], places={})
    tried = scans(model, effect(scanned), ROWS)  # type: ignore[arg-type]
    assert len(tried) * PARAMETERS * ROWS <= HELD
    for name in tried[0]:
        values = {one[name] for one in tried}
        assert min(values) == GRID[0] and max(values) == GRID[-1]
        if scanned > 1:  # values in between are tried for a single one only
            assert len(values) <= most_tried(effect(scanned), ROWS)


def test_steps_begin_at_any_time_of_all_groups_of_readings() -> None:
    """Distances of the first stations only, angles of all: what moved later moved at a time of angles."""
    times = [np.array([0.0, 10.0, 20.0]), np.array([0.0, 10.0, 30.0, 40.0])]
    groups = [SimpleNamespace(observations=SimpleNamespace(conditions={"t": own})) for own in times]
    step = Effect("moved", "", (Parameter("dx"),), by="t", scanned=(Parameter("at", "time", grid=change_points),))
    found = scans(SimpleNamespace(readings=groups, places={}), step, ROWS)
    assert [one["at"] for one in found] == [5.0, 15.0, 25.0, 35.0]
