"""What the direction of travel does across an axis and to its carriage: planted by plain formulas, named, estimated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from simulated import machine as sim
from simulated.machine import line, line_table

from benchmarks.hidden import machine
from metrocli.diagnosis.diagnose import diagnose, what_can_be_seen
from metrocli.diagnosis.findings import Diagnosis
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine
from metrocli.tasks.calibrate_machine.machine_settings import MachineNoise

Array = NDArray[np.float64]
WIDTH, TILT = 0.012, np.array([4e-5, -3e-5, 5e-5])
FEW = (3, 160)
"""Knots of each axis, and points"""


def shifted(m: machine.Measurement) -> Array:
    """The reversal of x shifts along z, in the machine (n, 3)."""
    return m.came[:, :1] / 2 * np.array([0.0, 0.0, WIDTH])


def tipped(m: machine.Measurement) -> Array:
    """The reversal of y tips its carriage: chain XYZ, so that z and the tool are its lever."""
    lever = np.array(list(machine.TOOLS.values()))[m.tool] + m.at * [0.0, 0.0, 1.0]
    return np.cross(m.came[:, 1:2] / 2 * TILT, lever)


PLANTED = {
    "straightness-reversal": (shifted, ("xz",), [WIDTH]),
    "angular-reversal": (tipped, ("y",), list(TILT)),
}


def found(diagnosis: Diagnosis, name: str, place: tuple[str, ...], truth: list[float]) -> None:
    """Assert that the effect, and no other, is named with its sizes."""
    (finding,) = diagnosis.findings
    assert (finding.effect.alternative.effect.name, finding.effect.alternative.instance) == (name, place)
    for size, value in zip(finding.sizes, truth, strict=True):
        assert abs(size.value - value) < 4.5 * size.std
        assert size.std < abs(value) / 3


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTED)
def test_a_tracker_shows_it(name: str) -> None:
    change, place, truth = PLANTED[name]
    m = machine.measurement(np.random.default_rng(81), FEW)
    assert not diagnose(m.adjusted()).findings
    found(diagnose(replace(m, read=m.read + change(m) @ m.turn).adjusted()), name, place, truth)


def along_lines(change: Callable[[str, Array], Array], seed: int = 82) -> Table:
    """Lines along the axes, each run to and fro with one zero, and diagonals; `change` by axis and sense of travel."""
    rng = np.random.default_rng(seed)
    true = sim.random_machine(rng, knots=(5, 5, 5), size=0.02)
    lines = []
    for axis in "xyz":
        one = line(true, axis, rng, 0.0, n=21)
        sense = np.repeat([1.0, -1.0], 21)
        run = {key: np.concatenate([values, values[::-1]]) for key, values in one.items()}
        channels = np.stack([run[name] for name in sim.CHANNELS]) + change(axis, sense)
        channels += rng.normal(size=channels.shape) * np.array([[1e-3]] * 3 + [[1e-6]] * 3)
        lines.append(run | dict(zip(sim.CHANNELS, channels, strict=True)))
    return line_table([*lines, *(line(true, axis, rng) for axis in ("xy", "yz", "xz"))])


def of_lines(table: Table) -> Diagnosis:
    noise = MachineNoise(displacement=1e-3, straightness=1e-3, angle=1e-6)
    settings = sim.settings("six-dof", tools={"": (0.0, 0.0, 0.0)}, noise=noise)
    return diagnose(calibrate_machine.diagnosed(calibrate_machine.TASK.job(settings, lines=table)))


@pytest.mark.slow
def test_a_laser_reads_the_shift() -> None:
    def change(axis: str, sense: Array) -> Array:
        return np.outer([0, 0, 0.004, 0, 0, 0], sense / 2) * (axis == "x")

    assert not of_lines(along_lines(lambda axis, sense: 0 * np.outer(np.ones(6), sense))).findings
    found(of_lines(along_lines(change)), "straightness-reversal", ("xz",), [0.004])


@pytest.mark.slow
def test_a_laser_reads_the_tilt() -> None:
    """The receiver is at the tool, with no lever on the axis z, the last of the chain."""

    def change(axis: str, sense: Array) -> Array:
        return np.outer([0, 0, 0, 4e-6, -8e-6, 6e-6], sense / 2) * (axis == "z")

    found(of_lines(along_lines(change)), "angular-reversal", ("z",), [4e-6, -8e-6, 6e-6])


@pytest.mark.slow
def test_points_approached_from_one_side_do_not_show_it() -> None:
    """It is the same at all points then, and the tables stay as they are."""
    m = machine.measurement(np.random.default_rng(83), FEW)
    seen = what_can_be_seen(replace(m, came=np.ones_like(m.came)).adjusted())
    unseen = {one.alternative.instance: one for one in seen.candidates if str(one.alternative).startswith("straight")}
    assert set(unseen) == {("xy",), ("xz",), ("yx",), ("yz",), ("zx",), ("zy",)}
    assert all(np.isinf(one.detectable) and one.absorbed_by for one in unseen.values())
    assert max(one.undetected.size for one in unseen.values()) < 1e-6


@pytest.mark.slow
def test_a_shift_and_a_tilt_are_not_told_apart_with_one_tool_on_the_last_axis() -> None:
    """The lever of z, the last axis of the chain, is the tool alone."""
    whole = machine.measurement(np.random.default_rng(84), (3, 420))
    one = whole.tool == 0
    kept = {name: getattr(whole, name)[one] for name in ("at", "tool", "came", "t", "read")}
    m = replace(whole, **kept)
    m = replace(m, read=m.read + m.came[:, 2:] / 2 * np.array([0.02, 0.0, 0.0]) @ m.turn)
    (finding,) = diagnose(m.adjusted()).findings
    names = {str(finding.effect.alternative), *(str(rival.alternative) for rival in finding.effect.rivals)}
    assert {"straightness-reversal zx", "angular-reversal z"} <= names
