"""Figures of ISO 230-2 of a rotary axis from an R-test that follows it up and down."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated import five_axis as sim

from metrocli.project.inputs import read_inputs
from metrocli.project.job import load
from metrocli.result import Result
from metrocli.tasks.calibrate_machine import task as calibrate_machine

BACKLASH, SCATTER, SIGMA = 20e-6, 2e-6, 2e-4


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, np.ndarray]:
    """The result of an R-test with five runs up and five down, and the true deviations (runs, ways, targets)."""
    rng, folder = np.random.default_rng(61), tmp_path_factory.mktemp("runs")
    machine = sim.drawn(sim.KINDS["table-table"], rng, linear=False)
    ball, tool = np.array(machine.kind.balls[0]) + 0.4, np.array(machine.kind.tools["T1"])
    job = sim.probed(folder, machine, rng, 120, SIGMA, rtest=True)
    rows = (folder / "probing.csv").read_text().splitlines()
    own = np.interp(np.arange(0, 360, 40) * sim.DEG, machine.knots["C"], machine.tables["ECC"])
    true, time = np.zeros((5, 2, 9)), 1e4
    for run in range(5):
        for way, side in enumerate((1, -1)):
            for number in range(9)[::side]:
                more = side * BACKLASH / 2 + rng.normal() * SCATTER
                true[run, way, number] = own[number] + more
                pose = {**dict.fromkeys(machine.knots, 0.0), "C": 40 * number * sim.DEG, "A": -30 * sim.DEG}
                met = sim._meeting(machine.perfect(), pose, np.array(machine.kind.balls[0]), tool)
                met = {key: round(value, 3) if key in sim.LINEAR else value for key, value in met.items()}
                off = np.array([0, 0, 0, 0, 0, more, 0, 0, 0])
                machine.disturbed = lambda letter, s, i, off=off: off * (letter == "C")  # type: ignore[misc]
                workpiece, spindle = machine.sides(met)
                read = (workpiece @ np.append(ball, 1) - spindle @ np.append(tool, 1))[:3] + rng.normal(size=3) * SIGMA
                numbers = ",".join(f"{1e3 * x:.7f}" for x in read)
                rows.append(f"K9,{sim.cells(met)},{numbers},T1,{time},0,{side}")
                time += 10
    (folder / "probing.csv").write_text("\n".join(rows) + "\n")
    with (folder / "balls.csv").open("a") as file:
        file.write(f"K9,{','.join(map(str, machine.kind.balls[0]))},\n")
    loaded = load(job)
    held = calibrate_machine.TASK.job(loaded.settings, effects=loaded.effects, **read_inputs(loaded))
    return calibrate_machine.run(held), true


def test_figures_are_those_of_the_true_deviations(made: tuple[Result, np.ndarray]) -> None:
    result, true = made
    table = result.tables["positioning"]
    assert [table.texts(name) for name in ("axis", "at")] == [["C"], ["A = -30 deg"]]
    assert (table.numbers("runs_up")[0], table.numbers("runs_down")[0]) == (5, 5)
    mean, spread = true.mean(axis=0), true.std(axis=0, ddof=1)
    expected = {
        "B": np.abs(mean[0] - mean[1]).max(),
        "M": np.ptp(mean.mean(axis=0)),
        "E": np.ptp(mean),
        "R_up": 4 * spread[0].max(),
        "A": (mean + 2 * spread).max() - (mean - 2 * spread).min(),
    }
    for name, value in expected.items():
        assert abs(table.numbers(name)[0] - value) < 1.2 * table.numbers(f"U_{name}")[0], name
        assert table.numbers(f"U_{name}")[0] < 0.6 * value, name


def test_targets_are_in_degrees_and_their_means_near_the_truth(made: tuple[Result, np.ndarray]) -> None:
    result, true = made
    table = result.tables["positioning_targets"]
    assert np.allclose(np.degrees(table.numbers("angle")), np.arange(0, 360, 40))
    off = table.numbers("up") - true[:, 0].mean(axis=0)
    assert np.abs(off - off.mean()).max() < 4e-6


def test_scattered_poses_have_no_figures(tmp_path: Path) -> None:
    """Of one axis alone some poses stand in a row by chance: they are not runs, and nobody is told what they lack."""
    two = sim.KINDS["table-table"]
    for kind in (two, replace(two, chain="CbXYZ", axes={key: own for key, own in two.axes.items() if key != "A"})):
        rng = np.random.default_rng(62)
        machine = sim.drawn(kind, rng, linear=False)
        loaded = load(sim.probed(tmp_path, machine, rng, 60, 5e-4, estimate="locations"))
        held = calibrate_machine.TASK.job(loaded.settings, effects=loaded.effects, **read_inputs(loaded))
        result = calibrate_machine.run(held)
        assert "positioning" not in result.tables
        assert not any("ISO 230-2" in warning for warning in result.warnings)
