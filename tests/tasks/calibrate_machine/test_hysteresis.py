"""A reversal error that builds up over the way since the turn: planted by a loop over the readings, named, estimated."""

from __future__ import annotations

from math import exp

import numpy as np
import pytest
from numpy.typing import NDArray
from simulated import machine as sim

from benchmarks.hidden import machine
from metrocli.diagnosis.diagnose import diagnose, what_can_be_seen
from metrocli.diagnosis.findings import Diagnosis
from metrocli.instruments.machine_path import Path, since_turn
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.machine_settings import MachineNoise

Array = NDArray[np.float64]
WIDTH = 0.006


def wound(places: Array, length: float) -> Array:
    """The error along an axis that comes from below, turns at some places, and winds up the other way."""
    side, way, errors = 1.0, float("inf"), []
    for before, place in zip([places[0], *places[:-1]], places, strict=True):
        if (place - before) * side < 0:
            side, way = -side, 0.0
        way += abs(place - before)
        errors.append(side * WIDTH / 2 * (1 - 2 * exp(-way / length)))
    return np.array(errors)


def of_lines(length: float, seed: int = 121) -> Diagnosis:
    """Lines to and fro twice, 41 targets each; the axis x has the hysteresis, not its diagonals, which are run once."""
    rng = np.random.default_rng(seed)
    true = sim.random_machine(rng, size=0.02)
    lines = []
    for axis in "xyz":
        one = sim.line(true, axis, rng, 0.0, n=41)
        run = {key: np.concatenate([values, values[::-1]] * 2) for key, values in one.items()}
        channels = np.stack([run[name] for name in sim.CHANNELS])
        error = wound(run["x"], length) if length else WIDTH / 2 * np.repeat([1.0, -1.0, 1.0, -1.0], 41)
        channels[0] += error * (axis == "x")
        channels += rng.normal(size=channels.shape) * np.array([[5e-4]] * 3 + [[1e-6]] * 3)
        lines.append(run | dict(zip(sim.CHANNELS, channels, strict=True)))
    lines += [sim.line(true, axis, rng) for axis in ("xy", "yz", "xz")]
    settings = sim.settings(
        "six-dof", tools={"": (0.0, 0.0, 0.0)}, noise=MachineNoise(displacement=5e-4, straightness=1e-3, angle=1e-6)
    )
    return diagnose(calibrate_machine.diagnosed(calibrate_machine.TASK.job(settings, lines=sim.line_table(lines))))


@pytest.mark.slow
@pytest.mark.parametrize("true", [60.0, 120.0])
def test_what_builds_up_is_named_beside_the_backlash_that_it_ends_in(true: float) -> None:
    found = {str(one.effect.alternative): one.sizes for one in of_lines(true).findings}
    assert set(found) == {"backlash x", "hysteresis x"}
    (backlash,), (width, length) = found["backlash x"], found["hysteresis x"]
    assert length.value == pytest.approx(true, rel=0.35)
    for size in (backlash, width):
        assert size.std < WIDTH / 10
        assert size.value == pytest.approx(WIDTH, rel=0.15)


@pytest.mark.slow
def test_what_is_there_at_once_is_backlash() -> None:
    """The axis goes beyond the last target and comes back, so that all is built up there."""
    (finding,) = of_lines(0.0).findings
    assert str(finding.effect.alternative) == "backlash x"


def test_the_way_since_a_turn() -> None:
    moves = np.array([0.0, 3.0, 2.0, -1.0, 0.0, -4.0, 5.0])
    side = np.array([1.0, 1, 1, -1, -1, -1, 1])
    assert since_turn(moves, side).tolist() == [np.inf, np.inf, np.inf, 1.0, 1.0, 5.0, 5.0]  # type: ignore[union-attr]
    assert since_turn(moves, np.ones(7)) is None


def test_a_move_beyond_and_back_leaves_the_way_open_up_to_the_next_turn() -> None:
    """One of eleven moves contradicts its side."""
    moves = np.array([0.0, 3, -1, -2, 4, -1, -5, -3, -1, 2, 2, 1])
    side = np.array([1.0, 1, -1, -1, 1, 1, -1, -1, -1, 1, 1, 1])
    expected = [np.inf, np.inf, 1.0, 3.0, 4.0, np.inf, 5.0, 8.0, 9.0, 2.0, 4.0, 5.0]
    assert since_turn(moves, side).tolist() == expected  # type: ignore[union-attr]


def test_the_way_since_a_turn_on_a_path() -> None:
    path = Path.of(np.array([[0.0, 0, 0], [30, 40, 0], [30, 0, 0], [0, 0, 0]]), np.zeros(4, dtype=int))
    found = path.since_turns(np.array([0, 1, 1, 2]), np.array([10.0, 5.0, 40.0, 12.0]))
    assert found["since_x"].tolist() == [np.inf, np.inf, np.inf, 12.0]
    assert found["since_y"].tolist() == [np.inf, 5.0, 40.0, 40.0]


@pytest.mark.slow
def test_sides_that_contradict_the_order_are_not_a_way() -> None:
    m = machine.measurement(np.random.default_rng(123), (3, 160))
    m.came[:, 1] *= -1
    missing = [one for one in what_can_be_seen(m.adjusted()).not_tested if one.effect.name == "hysteresis"]
    assert [(dict(one.where), one.reason) for one in missing] == [
        ({"axis": "y"}, "needs a column from_y that agrees with the order of the readings")
    ]


def test_an_axis_that_stands_still_does_not_turn() -> None:
    moves = np.array([0.0, 0.0, 3.0, 0.0, 2.0, -1.0, 0.0, -4.0])
    side = np.array([0.0, 0, 1, 0, 1, -1, 0, -1])
    held = np.array([0.0, 0, 1, 1, 1, -1, -1, -1])
    expected = [np.inf] * 5 + [1.0, 1.0, 5.0]
    for one in (side, held):
        assert since_turn(moves, one).tolist() == expected  # type: ignore[union-attr]
